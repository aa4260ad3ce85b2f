//! Numbers as text, rounded to significant digits.

/// Decimals that show `digits` significant digits of a number, at most seven.
fn decimals(value: f64, digits: i32) -> usize {
    let size = value.abs();
    if size == 0.0 || !size.is_finite() {
        return 0;
    }
    let leading = size.log10().floor() as i32;
    (digits - 1 - leading).clamp(0, 7) as usize
}

/// The same text; of zero without a minus sign, with `sign` in its place.
fn of_zero(text: String, sign: &str) -> String {
    let is_zero = !text.contains(|c: char| matches!(c, '1'..='9' | 'N' | 'i'));
    match text.strip_prefix('-') {
        Some(rest) if is_zero => format!("{sign}{rest}"),
        _ => text,
    }
}

/// A number with `digits` significant digits; those before the decimal point are all shown.
pub fn significant(value: f64, digits: i32) -> String {
    of_zero(format!("{value:.0$}", decimals(value, digits)), "")
}

/// As [`significant`], with the sign of a positive number.
pub fn signed(value: f64, digits: i32) -> String {
    of_zero(format!("{value:+.0$}", decimals(value, digits)), "+")
}

/// `1.0023 ± 0.0012`: the standard deviation with two significant digits, the value with as many decimals.
/// A standard deviation below 5·10⁻⁸ is shown as `± 0` behind a value with five decimals.
pub fn with_sd(value: f64, sd: f64) -> String {
    let [value, sd] = parts(value, sd);
    format!("{} ± {sd}", value.trim_start_matches('+'))
}

/// As [`with_sd`], with the sign of a positive value.
pub fn signed_with_sd(value: f64, sd: f64) -> String {
    let [value, sd] = parts(value, sd);
    format!("{value} ± {sd}")
}

/// `E +1.002 N +0.000 U -0.250`: components with three decimals, zero without a minus sign.
pub fn east_north_up(components: [f64; 3]) -> String {
    let [e, n, u] = components.map(|axis| of_zero(format!("{axis:+.3}"), "+"));
    format!("E {e} N {n} U {u}")
}

fn parts(value: f64, sd: f64) -> [String; 2] {
    if sd < 5e-8 {
        return [of_zero(format!("{value:+.5}"), "+"), "0".to_owned()];
    }
    let decimals = decimals(sd, 2);
    let value = of_zero(format!("{value:+.decimals$}"), "+");
    [value, format!("{sd:.decimals$}")]
}
