//! Colours as scene files write them.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// A colour: red, green and blue in 0..=1, as PNG codes over their maximum (no gamma is applied anywhere). Scene files
/// write `"#rrggbb"` or `[r, g, b]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "[f64; 3]")]
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

/// Reads either way to write a colour; one visitor rather than an untagged enum, whose errors say nothing.
struct Written;

impl<'de> Visitor<'de> for Written {
    type Value = Colour;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a colour, \"#rrggbb\" or [red, green, blue] in 0..1")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Colour, E> {
        text.parse().map_err(E::custom)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut parts: A) -> Result<Colour, A::Error> {
        let mut rgb = [0.0; 3];
        for (i, part) in rgb.iter_mut().enumerate() {
            *part = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
        }
        match parts.next_element::<IgnoredAny>()? {
            None => Colour::new(rgb).map_err(A::Error::custom),
            Some(_) => Err(A::Error::invalid_length(4, &self)),
        }
    }
}

impl<'de> Deserialize<'de> for Colour {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_any(Written)
    }
}

impl JsonSchema for Colour {
    fn schema_name() -> Cow<'static, str> {
        "Colour".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A colour: \"#rrggbb\", or red, green and blue in 0..1.",
            "anyOf": [
                { "type": "string", "pattern": "^#[0-9a-fA-F]{6}$" },
                {
                    "type": "array", "minItems": 3, "maxItems": 3,
                    "items": { "type": "number", "minimum": 0, "maximum": 1 },
                },
            ],
        })
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
