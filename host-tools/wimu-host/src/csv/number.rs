//! Lossless conversion of numbers from and to text.

/// A finite number.
pub fn finite(text: &str) -> Option<f64> {
    // `parse` also takes "inf" and "nan".
    text.parse::<f64>().ok().filter(|value| value.is_finite())
}

/// Whether a field has no number: empty, or as programs write a missing value.
pub fn is_none(text: &str) -> bool {
    let written = ["", "na", "n/a", "null", "none"];
    written.iter().any(|none| text.eq_ignore_ascii_case(none))
        || text.parse::<f64>().is_ok_and(|value| !value.is_finite())
}

/// `text` · 10^`exponent` as an integer, rounded half away from zero, in integer arithmetic so
/// that a UTC time in seconds keeps its nanoseconds. `None` if it is not a decimal number or does not fit.
pub fn decimal(text: &str, exponent: i32) -> Option<i64> {
    // Digits after the 20th of a fraction are far below a nanosecond.
    const MAX_FRACTION: usize = 20;
    if finite(text)? == 0.0 {
        return Some(0);
    }
    let (mantissa, power) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let fraction = &fraction[..fraction.len().min(MAX_FRACTION)];
    let digits: i128 = format!("{whole}{fraction}").parse().ok()?;
    let power = power.parse::<i32>().ok()?.checked_add(exponent)?;
    let shift = power.checked_sub(i32::try_from(fraction.len()).ok()?)?;
    let factor = 10_i128.checked_pow(shift.unsigned_abs());
    let value = match (shift >= 0, factor) {
        (true, factor) => digits.checked_mul(factor?)?,
        (false, Some(divisor)) => (digits + digits.signum() * (divisor / 2)) / divisor,
        (false, None) => 0,
    };
    i64::try_from(value).ok()
}

/// Nanoseconds as a decimal number of seconds, exact.
pub fn seconds(ns: i64) -> String {
    let sign = if ns < 0 { "-" } else { "" };
    let ns = ns.unsigned_abs();
    let (whole, fraction) = (ns / 1_000_000_000, ns % 1_000_000_000);
    if fraction == 0 {
        format!("{sign}{whole}")
    } else {
        let digits = format!("{fraction:09}");
        format!("{sign}{whole}.{}", digits.trim_end_matches('0'))
    }
}
