//! Draws in proportion to shares, evenly along a list.

/// Draws so many from a list in proportion to their shares, which add up to 1, evenly along it, begun at `start` in [0, 1): their places in the
/// list, and for how many each stands.
pub(crate) fn draw(shares: &[f64], number: usize, start: f64) -> (Vec<usize>, Vec<f64>) {
    let (mut at, mut sum) = (0, shares.first().copied().unwrap_or(0.0));
    let one = |n: usize| {
        let wanted = (n as f64 + start) / number as f64;
        while sum <= wanted && at + 1 < shares.len() {
            at += 1;
            sum += shares[at];
        }
        (at, 1.0 / (number as f64 * shares[at]))
    };
    (0..number).map(one).unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums by what is drawn, and what it stands for, are those of the whole, whatever the shares.
    #[test]
    fn draws_stand_for_the_whole() {
        let shares: Vec<f64> = (0..40).map(|n| if n % 7 == 3 { 9.0 } else { 0.5 + f64::from(n % 3) }).collect();
        let whole = shares.iter().sum::<f64>();
        let shares: Vec<f64> = shares.iter().map(|s| s / whole).collect();
        let value = |n: usize| (n * n % 11) as f64;
        let truth = (0..40).map(value).sum::<f64>();
        let of = |start: f64| {
            let (drawn, weights) = draw(&shares, 16, start);
            drawn.iter().zip(&weights).map(|(n, w)| w * value(*n)).sum::<f64>()
        };
        let mean = (0..4000).map(|n| of((f64::from(n) + 0.5) / 4000.0)).sum::<f64>() / 4000.0;
        assert!((mean - truth).abs() < 1e-3 * truth, "{mean} {truth}");
        assert_eq!(draw(&[], 0, 0.5), (vec![], vec![]));
    }
}
