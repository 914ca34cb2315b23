//! Numbers as people read them: three significant digits, a unit, and no more.

/// `digits` significant digits without an exponent.
pub fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    // The exponent after rounding, so that 9.996 has two decimals less than 9.99.
    let text = format!("{value:.*e}", (digits - 1).max(0) as usize);
    let exponent: i32 = text.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    let rounded: f64 = text.parse().unwrap_or(value);
    format!("{rounded:.*}", (digits - 1 - exponent).clamp(0, 17) as usize).replace('-', "−")
}

/// `0.392` as `39.2 %`.
pub fn percent(value: f64) -> String {
    format!("{} %", significant(100.0 * value, 3))
}

/// Seconds with the unit that suits.
pub fn seconds(value: f64) -> String {
    scaled(value, 3)
}

/// Axis label of a time.
pub(crate) fn seconds_tick(value: f64) -> String {
    scaled(value, 1)
}

fn scaled(value: f64, digits: i32) -> String {
    let (scale, unit) = match value.abs() {
        v if v >= 0.9995 => (1.0, "s"),
        v if v >= 0.9995e-3 => (1e3, "ms"),
        v if v >= 0.9995e-6 => (1e6, "µs"),
        0.0 => (1.0, "s"),
        _ => (1e9, "ns"),
    };
    format!("{} {unit}", significant(value * scale, digits))
}

/// Axis label of a relative error.
pub(crate) fn percent_tick(value: f64) -> String {
    format!("{} %", significant(100.0 * value, 1))
}

/// Axis label of a count: `10⁶`, `2·10⁶`.
pub(crate) fn power_tick(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    let factor = (value / 10f64.powi(exponent)).round();
    let raised: String = exponent.to_string().chars().map(superscript).collect();
    if factor == 1.0 { format!("10{raised}") } else { format!("{factor}·10{raised}") }
}

fn superscript(digit: char) -> char {
    const RAISED: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    digit.to_digit(10).map_or('⁻', |d| RAISED[d as usize])
}

/// `1000000` as `1,000,000`.
pub(crate) fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `1,048,576 (2²⁰)` for large powers of two, otherwise the grouped number.
pub fn samples(value: u64) -> String {
    if value >= 1024 && value.is_power_of_two() {
        let raised: String = value.trailing_zeros().to_string().chars().map(superscript).collect();
        format!("{} (2{raised})", grouped(value))
    } else {
        grouped(value)
    }
}

/// A figure and its standard error, both to the error's decimals: `39.04 ± 0.07`.
pub(crate) fn with_error(value: f64, error: f64) -> String {
    // A spread of the size of rounding belongs to a figure that does not vary.
    if !(error > 1e-9 * value.abs() && error.is_finite()) {
        return significant(value, 3);
    }
    // One digit of the error, two where it begins with 1.
    let digits = if format!("{error:e}").starts_with('1') { 2 } else { 1 };
    let decimals = |text: String| text.split_once('.').map_or(0, |(_, d)| d.len());
    let places = decimals(significant(error, digits)).min(12);
    format!("{value:.places$} ± {error:.places$}").replace('-', "−")
}

/// `2²⁰` for large powers of two, otherwise the grouped number.
pub(crate) fn short_samples(value: u64) -> String {
    samples(value).split_once('(').map_or(grouped(value), |(_, power)| power.trim_end_matches(')').to_owned())
}

/// A slope with a true minus sign.
pub fn slope(value: f64) -> String {
    format!("{value:.3}").replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_as_people_write_them() {
        assert_eq!(significant(0.001_234_5, 3), "0.00123");
        assert_eq!(significant(9.996, 3), "10.0");
        assert_eq!(significant(123_456.0, 3), "123000");
        assert_eq!(significant(0.0, 3), "0");
        assert_eq!(percent(0.3917), "39.2 %");
        assert_eq!(seconds(1.192), "1.19 s");
        assert_eq!(seconds(0.012_34), "12.3 ms");
        assert_eq!(seconds(0.999_7), "1.00 s");
        assert_eq!(seconds(5e-8), "50.0 ns");
        assert_eq!(seconds_tick(0.1), "100 ms");
        assert_eq!(percent_tick(1e-5), "0.001 %");
        assert_eq!(power_tick(1e6), "10⁶");
        assert_eq!(power_tick(2e-3), "2·10⁻³");
        assert_eq!(grouped(1_000_000), "1,000,000");
        assert_eq!(grouped(999), "999");
        assert_eq!(samples(1 << 20), "1,048,576 (2²⁰)");
        assert_eq!(short_samples(1 << 20), "2²⁰");
        assert_eq!(short_samples(31_250), "31,250");
        assert_eq!(with_error(39.041, 0.067), "39.04 ± 0.07");
        assert_eq!(with_error(609.3, 12.3), "609 ± 12");
        assert_eq!(with_error(4.0, 0.0), "4.00");
        assert_eq!(slope(-0.5), "−0.500");
    }
}
