//! Colours as scene files write them.

use serde::{Deserialize, Serialize};

/// A colour: red, green and blue in 0..=1, as PNG codes over their maximum (no gamma is applied anywhere). Scene files
/// write `"#rrggbb"` or `[r, g, b]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "[f64; 3]")]
pub struct Colour([f64; 3]);

impl Colour {
    /// White.
    pub const WHITE: Colour = Colour([1.0; 3]);
    /// Black.
    pub const BLACK: Colour = Colour([0.0; 3]);

    /// A colour from its components.
    ///
    /// # Errors
    /// A message when one is not in 0..=1.
    pub fn new(rgb: [f64; 3]) -> Result<Self, String> {
        match rgb.iter().find(|c| !(0.0..=1.0).contains(*c)) {
            None => Ok(Self(rgb)),
            Some(c) => Err(format!("colour components lie in 0..1, got {c}; or write \"#rrggbb\"")),
        }
    }

    /// Red, green and blue.
    pub fn rgb(self) -> [f64; 3] {
        self.0
    }
}

impl std::str::FromStr for Colour {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let bad = || format!("'{s}' is not a colour; write #rrggbb");
        let digits = s.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii()).ok_or_else(bad)?;
        let part = |i: usize| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).map_err(|_| bad());
        Ok(Self([f64::from(part(0)?) / 255.0, f64::from(part(1)?) / 255.0, f64::from(part(2)?) / 255.0]))
    }
}

/// The two ways to write a colour.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Hex(String),
    Rgb([f64; 3]),
}

impl TryFrom<Written> for Colour {
    type Error = String;
    fn try_from(w: Written) -> Result<Self, String> {
        match w {
            Written::Hex(s) => s.parse(),
            Written::Rgb(rgb) => Self::new(rgb),
        }
    }
}

impl From<Colour> for [f64; 3] {
    fn from(c: Colour) -> Self {
        c.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_and_components_are_read_and_others_refused() {
        assert_eq!("#ff0033".parse::<Colour>().unwrap().rgb(), [1.0, 0.0, 0.2]);
        for bad in ["ff0033", "#ff003", "#gg0000", "#ff00é"] {
            assert!(bad.parse::<Colour>().is_err(), "{bad}");
        }
        assert!(Colour::new([0.0, 1.5, 0.0]).is_err() && Colour::new([0.0, f64::NAN, 0.0]).is_err());
    }
}
