//! The Sobol sequence in four dimensions, with 64-bit digits and indices.
//!
//! `sobol_burley` stops at 2^16 points and 23 bits; beyond that it silently repeats itself. Here the direction
//! numbers of Joe and Kuo (2008, *new-joe-kuo-6.21201*, first four dimensions) are regenerated as 64 columns of
//! 64 bits, so 2^64 points are distinct. Tests hold the first 2^16 points to `sobol_burley`'s digits.

/// Number of dimensions.
pub const DIMENSIONS: usize = 4;

/// Degree, inner coefficients and first direction integers of each dimension's primitive polynomial (none for
/// the first dimension, the van der Corput sequence).
const JOE_KUO: [(u32, u64, &[u64]); DIMENSIONS - 1] = [(1, 0, &[1]), (2, 1, &[1, 3]), (3, 1, &[1, 3, 1])];

/// Columns of a dimension's generator matrix: entry j is added (xor) for bit j of the index; bit 63 is the
/// first binary digit of the coordinate.
pub type Columns = [u64; 64];

/// The generator matrix of a dimension.
///
/// # Panics
/// When the dimension is not below [`DIMENSIONS`].
pub fn columns(dimension: usize) -> Columns {
    if dimension == 0 {
        return std::array::from_fn(|j| 1 << (63 - j));
    }
    let (degree, inner, first) = JOE_KUO[dimension - 1];
    let degree = degree as usize;
    // m_k = 2 a_1 m_{k-1} ^ 4 a_2 m_{k-2} ^ ... ^ 2^s m_{k-s} ^ m_{k-s}, in columns v_k = m_k 2^(63-k).
    let mut v = [0u64; 64];
    for k in 0..64 {
        v[k] = if k < degree {
            first[k] << (63 - k)
        } else {
            let mut c = v[k - degree] ^ (v[k - degree] >> degree);
            for i in 1..degree {
                if inner >> (degree - 1 - i) & 1 == 1 {
                    c ^= v[k - i];
                }
            }
            c
        };
    }
    v
}

/// Digits of the point with the given index.
pub fn point(columns: &Columns, index: u64) -> u64 {
    let (mut rest, mut digits) = (index, 0);
    while rest != 0 {
        digits ^= columns[rest.trailing_zeros() as usize];
        rest &= rest - 1;
    }
    digits
}

#[cfg(test)]
mod tests {
    use super::*;
    use sobol_burley::parts::sobol_rev;

    #[test]
    fn the_first_65536_points_are_those_of_sobol_burley() {
        for dimension in 0..DIMENSIONS {
            let c = columns(dimension);
            for index in 0..1u32 << 16 {
                let oracle = sobol_rev(index.reverse_bits(), dimension as u32).reverse_bits();
                assert_eq!((point(&c, u64::from(index)) >> 32) as u32, oracle, "dimension {dimension}, index {index}");
            }
        }
    }

    #[test]
    fn every_dyadic_interval_of_a_dimension_holds_one_of_2_to_the_m_points() {
        for dimension in 0..DIMENSIONS {
            let c = columns(dimension);
            for m in 0..=16 {
                let mut seen = vec![false; 1 << m];
                for index in 0..1u64 << m {
                    let cell = if m == 0 { 0 } else { point(&c, index) >> (64 - m) };
                    assert!(!std::mem::replace(&mut seen[cell as usize], true), "dimension {dimension}, m {m}");
                }
            }
        }
    }

    #[test]
    fn columns_are_independent_so_no_index_repeats_another() {
        // A unit diagonal makes the matrix invertible: 2^64 distinct points.
        for dimension in 0..DIMENSIONS {
            for (j, column) in columns(dimension).into_iter().enumerate() {
                assert_eq!(column.trailing_zeros() as usize, 63 - j, "dimension {dimension}");
            }
        }
    }

    #[test]
    fn there_is_no_repeat_where_16_or_32_bits_end() {
        let c = columns(1);
        for near in [1u64 << 16, 1 << 20, 1 << 24, 1 << 32, 1 << 48] {
            let around: Vec<u64> = (near - 2..near + 3).chain(0..5).map(|i| point(&c, i)).collect();
            let distinct: std::collections::HashSet<_> = around.iter().collect();
            assert_eq!(distinct.len(), around.len(), "{near}");
        }
    }
}
