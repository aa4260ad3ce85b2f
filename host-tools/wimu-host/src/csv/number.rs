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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn decimals_are_exact() {
        for (text, exponent, expected) in [
            ("0.07829", 9, Some(78_290_000)),
            ("1795222920.123456789", 9, Some(1_795_222_920_123_456_789)),
            ("-0.0000000005", 9, Some(-1)),
            ("12.5", 6, Some(12_500_000)),
            ("3", 0, Some(3)),
            ("1e-3", 9, Some(1_000_000)),
            ("2.5E+1", 3, Some(25_000)),
            (".5", 9, Some(500_000_000)),
            ("5.", 9, Some(5_000_000_000)),
            ("+7", 0, Some(7)),
            ("0.00000000000000000000000000000000000000000001", 9, Some(0)),
            ("1e-2147483648", 9, Some(0)),
            ("0e999", 9, Some(0)),
            ("9223372037", 9, None),
            ("1e999", 9, None),
            ("", 9, None),
            (".", 9, None),
            ("-", 9, None),
            ("1.2.3", 9, None),
            ("1e", 9, None),
            ("0x10", 0, None),
        ] {
            assert_eq!(decimal(text, exponent), expected, "{text}");
        }
    }

    proptest! {
        #[test]
        fn a_time_in_seconds_reads_back_as_written(ns: i64) {
            prop_assert_eq!(decimal(&seconds(ns), 9), Some(ns));
        }

        #[test]
        fn no_text_panics(text in "[-+.eE0-9]{0,60}", exponent in 0..10_i32) {
            if let Some(value) = decimal(&text, exponent) {
                let reference = text.parse::<f64>().unwrap() * 10_f64.powi(exponent);
                prop_assert!((value as f64 - reference).abs() <= reference.abs() * 1e-9 + 1.0);
            }
        }
    }
}
