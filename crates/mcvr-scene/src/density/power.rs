//! Powers of two as floating-point numbers, down to the smallest.

/// Two to the given power; 0 below the smallest positive number, infinite above the largest. Exact, which `powi` is not
/// for numbers below 2^-1022.
pub fn power_of_two(exponent: i32) -> f64 {
    match exponent {
        1024.. => f64::INFINITY,
        -1022..=1023 => f64::from_bits(((exponent + 1023) as u64) << 52),
        -1074..=-1023 => f64::from_bits(1 << (exponent + 1074)),
        _ => 0.0,
    }
}

/// The power of two at or below a positive finite number.
pub(crate) fn exponent(v: f64) -> i32 {
    match (v.to_bits() >> 52) as i32 {
        0 => 63 - v.to_bits().leading_zeros() as i32 - 1074,
        biased => (biased & 0x7ff) - 1023,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_two_is_its_own() {
        let mut v = 5e-324;
        for e in -1074..1024 {
            assert_eq!((power_of_two(e), exponent(v)), (v, e));
            assert_eq!(exponent(v.next_up().next_down()), e);
            v *= 2.0;
        }
        assert_eq!((power_of_two(-1075), power_of_two(1024)), (0.0, f64::INFINITY));
        assert_eq!((exponent(f64::MAX), exponent(1.5), exponent(1f64.next_down())), (1023, 0, -1));
    }
}
