//! Numbers as people write them: `2^20`, `1e6`, `1_000_000`, `4M`; lists and ranges of them; triples.

/// One count: decimal, with `_`, with `^` as power, with an exponent, or with k, M, G (thousands).
pub fn count(text: &str) -> Result<u64, String> {
    let bad = || format!("'{text}' is not a count; write 1000000, 1_000_000, 1e6, 1M or 2^20");
    let clean = text.trim().replace('_', "");
    let value = if let Some((base, exponent)) = clean.split_once('^') {
        let base: u64 = base.parse().map_err(|_| bad())?;
        base.checked_pow(exponent.parse().map_err(|_| bad())?).ok_or_else(|| format!("'{text}' is too large"))?
    } else if let Ok(whole) = clean.parse::<u64>() {
        whole
    } else {
        let (digits, unit) = match clean.char_indices().next_back() {
            Some((i, 'k')) => (&clean[..i], 1e3),
            Some((i, 'M')) => (&clean[..i], 1e6),
            Some((i, 'G')) => (&clean[..i], 1e9),
            _ => (&clean[..], 1.0),
        };
        let value = digits.parse::<f64>().map_err(|_| bad())? * unit;
        if value.fract() != 0.0 || !(0.0..=2f64.powi(53)).contains(&value) {
            return Err(bad());
        }
        value as u64
    };
    if value == 0 { Err(format!("'{text}': at least 1")) } else { Ok(value) }
}

/// Counts separated by commas; `2^10..2^24` doubles from the first to the last, both included.
pub fn counts(text: &str) -> Result<Vec<u64>, String> {
    let mut all = vec![];
    for part in text.split(',') {
        let Some((from, to)) = part.split_once("..") else {
            all.push(count(part)?);
            continue;
        };
        let (mut from, to) = (count(from)?, count(to)?);
        if from > to {
            return Err(format!("'{part}': the first count must not exceed the last"));
        }
        while from <= to {
            all.push(from);
            from = from.checked_mul(2).ok_or("the range is too large")?;
        }
    }
    Ok(all)
}

/// A list of `N` values separated by commas (or `x`, for extents).
fn list<T: std::str::FromStr, const N: usize>(text: &str, separators: &[char], what: &str) -> Result<[T; N], String> {
    let parts: Vec<T> = text
        .split(separators)
        .map(|p| p.trim().parse().map_err(|_| format!("'{text}': '{p}' is not a number; write {what}")))
        .collect::<Result<_, _>>()?;
    let n = parts.len();
    parts.try_into().map_err(|_| format!("'{text}' has {n} values; write {what}"))
}

/// `X,Y,Z` or `XxYxZ` voxels.
pub fn dims(text: &str) -> Result<[usize; 3], String> {
    list(text, &[',', 'x', 'X'], "X,Y,Z such as 256,256,113")
}

/// `X,Y,Z` millimetres.
pub fn spacing(text: &str) -> Result<[f64; 3], String> {
    list(text, &[','], "X,Y,Z millimetres such as 1,1,1.4")
}

/// Two numbers separated by a comma.
pub fn pair(text: &str) -> Result<[f64; 2], String> {
    list(text, &[','], "two numbers separated by a comma")
}

/// A pair of percentiles.
pub fn percentiles(text: &str) -> Result<[f64; 2], String> {
    let [low, high] = pair(text)?;
    if (0.0..high).contains(&low) && high <= 100.0 {
        Ok([low, high])
    } else {
        Err(format!("'{text}': write LOW,HIGH percentiles with 0 <= LOW < HIGH <= 100"))
    }
}

/// A share of a whole: `1%` or `0.01`.
pub fn share(text: &str) -> Result<f64, String> {
    let bad = || format!("'{text}' is no share; write 1% or 0.01");
    let clean = text.trim();
    let (digits, unit) = clean.strip_suffix('%').map_or((clean, 1.0), |d| (d.trim(), 100.0));
    let value = digits.parse::<f64>().map_err(|_| bad())? / unit;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(bad()) }
}

/// A time in seconds: `2s`, `500ms`, `1.5m`, or a plain number of seconds.
pub fn seconds(text: &str) -> Result<f64, String> {
    let bad = || format!("'{text}' is no time; write 2s, 500ms or 1m");
    let clean = text.trim();
    let at = clean.find(|c: char| c.is_ascii_alphabetic() && c != 'e').unwrap_or(clean.len());
    let (digits, unit) = clean.split_at(at);
    let unit = match unit {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(bad()),
    };
    let value = digits.trim().parse::<f64>().map_err(|_| bad())? * unit;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(bad()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_as_people_write_them() {
        for (text, value) in
            [("1", 1), ("2^20", 1 << 20), ("1e6", 1_000_000), ("1_000", 1000), ("1.5M", 1_500_000), ("3k", 3000)]
        {
            assert_eq!(count(text), Ok(value), "{text}");
        }
        for text in ["", "0", "-1", "1.5", "2^64", "x", "1e99", "nan"] {
            assert!(count(text).is_err(), "{text}");
        }
    }

    #[test]
    fn shares_and_times_are_read_with_their_units() {
        assert_eq!((share("1%"), share("0.05"), share(" 12.5 %")), (Ok(0.01), Ok(0.05), Ok(0.125)));
        for (text, value) in [("2s", 2.0), ("500ms", 0.5), ("1.5m", 90.0), ("3", 3.0), ("1e-1", 0.1), ("1h", 3600.0)] {
            assert_eq!(seconds(text), Ok(value), "{text}");
        }
        for bad in ["", "0", "-1%", "nan", "x", "%", "inf"] {
            assert!(share(bad).is_err() && seconds(bad).is_err(), "{bad}");
        }
        assert!(seconds("2 weeks").is_err());
    }

    #[test]
    fn ranges_double() {
        assert_eq!(counts("2^3..2^5,100").unwrap(), vec![8, 16, 32, 100]);
        assert!(counts("8..4").is_err());
    }

    #[test]
    fn lists_have_the_asked_length() {
        assert_eq!(dims("301x324x56"), Ok([301, 324, 56]));
        assert_eq!(spacing("1,1,1.4"), Ok([1.0, 1.0, 1.4]));
        assert!(dims("1,2").is_err() && percentiles("5,5").is_err() && percentiles("-1,5").is_err());
    }
}
