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

/// `text` × `factor` as an integer, rounded half away from zero, in integer arithmetic so that a UTC time in seconds keeps
/// its nanoseconds. `None` if it is not a decimal number or does not fit.
pub fn multiplied(text: &str, factor: i64) -> Option<i64> {
    // Digits after the 15th of a fraction are far below a nanosecond.
    const MAX_FRACTION: usize = 15;
    if finite(text)? == 0.0 {
        return Some(0);
    }
    let (mantissa, power) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let fraction = &fraction[..fraction.len().min(MAX_FRACTION)];
    let digits = format!("{whole}{fraction}").parse::<i128>().ok()?.checked_mul(factor.into())?;
    let shift = power.parse::<i32>().ok()?.checked_sub(i32::try_from(fraction.len()).ok()?)?;
    let power = 10_i128.checked_pow(shift.unsigned_abs());
    let value = match power {
        Some(power) if shift >= 0 => digits.checked_mul(power)?,
        Some(power) => (digits + digits.signum() * (power / 2)) / power,
        None if shift < 0 => 0,
        None => return None,
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
