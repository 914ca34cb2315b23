//! Hounsfield units to linear attenuation.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Substance;
use crate::SceneError;

/// Hounsfield units to linear attenuation per mm: either `mu_water * (1 + HU / 1000)`, or at a photon energy in keV from
/// the published attenuation of air, water and cortical bone.
///
/// At a photon energy `E`, a voxel is taken as a mixture of the two substances whose Hounsfield units (in the scan, so at
/// the scan's effective energy) enclose its own: nothing (-1000) and air, air and water (0), water and cortical bone; denser
/// voxels continue the last line. Between water and bone this is `μ_w(E) + HU/HU_bone · (μ_bone(E) - μ_w(E))`. Where `E` is
/// the scan's energy it is `μ_w(E) · (1 + HU/1000)`, as it must be by the definition of the Hounsfield unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Written", into = "Written")]
pub struct Hounsfield(Rule);

#[derive(Clone, Copy, Debug, PartialEq)]
enum Rule {
    /// Attenuation of water per mm.
    Water(f64),
    Energy {
        kev: f64,
        scan_kev: f64,
        /// Hounsfield units of air, water and bone in the scan, and their attenuations at `kev`.
        nodes: [[f64; 2]; 3],
    },
}

/// Hounsfield units to linear attenuation per mm: give mu_water, or kev.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Written {
    /// Attenuation of water per mm at the photon energy meant; instead of kev.
    #[serde(alias = "mu-water", skip_serializing_if = "Option::is_none")]
    mu_water: Option<f64>,
    /// Photon energy of the image in keV, 10 to 500; instead of mu_water.
    #[serde(skip_serializing_if = "Option::is_none")]
    kev: Option<f64>,
    /// Effective photon energy of the scan in keV, 10 to 500; 70 when absent. Only with kev.
    #[serde(rename = "scan-kev", alias = "scan_kev", skip_serializing_if = "Option::is_none")]
    scan_kev: Option<f64>,
}

impl Hounsfield {
    /// Effective energy of a CT scan in keV where none is given: that of a usual 120 kV beam.
    pub const SCAN_KEV: f64 = 70.0;

    /// From the attenuation of water per mm.
    ///
    /// # Errors
    /// [`SceneError::Density`] when it is not positive.
    pub fn of_water(mu_water: f64) -> Result<Self, SceneError> {
        if mu_water.is_finite() && mu_water > 0.0 {
            return Ok(Self(Rule::Water(mu_water)));
        }
        Err(SceneError::Density(format!(
            "hounsfield.mu_water: the attenuation of water must be positive per mm, got {mu_water}"
        )))
    }

    /// At a photon energy, of a scan of an effective energy, both in keV.
    ///
    /// # Errors
    /// [`SceneError::Density`] when one lies outside the published tables.
    pub fn at_energy(kev: f64, scan_kev: f64) -> Result<Self, SceneError> {
        let table = |key: &str, kev: f64| {
            let values = [Substance::Air, Substance::Water, Substance::Bone].map(|s| s.attenuation(kev));
            let [Some(air), Some(water), Some(bone)] = values else {
                let [low, high] = Substance::LIMITS;
                return Err(SceneError::Density(format!(
                    "hounsfield.{key}: the attenuation tables reach from {low} to {high} keV, got {kev}"
                )));
            };
            Ok([air, water, bone])
        };
        let (image, scan) = (table("kev", kev)?, table("scan-kev", scan_kev)?);
        let units = scan.map(|mu| 1000.0 * (mu - scan[1]) / scan[1]);
        let nodes = std::array::from_fn(|i| [units[i], image[i]]);
        Ok(Self(Rule::Energy { kev, scan_kev, nodes }))
    }

    /// Linear attenuation per mm; below -1000 negative, and as large as above it.
    pub fn attenuation(&self, hu: f64) -> f64 {
        match self.0 {
            Rule::Water(mu) => mu * (1.0 + hu / 1000.0),
            Rule::Energy { nodes: [air, water, bone], .. } => {
                if hu < air[0] {
                    air[1] * ((hu + 1000.0) / (air[0] + 1000.0))
                } else if hu < 0.0 {
                    water[1] + (hu / air[0]) * (air[1] - water[1])
                } else {
                    water[1] + (hu / bone[0]) * (bone[1] - water[1])
                }
            }
        }
    }

    /// Photon energy of the image and effective energy of the scan in keV, if it was made from energies.
    pub fn energies(&self) -> Option<[f64; 2]> {
        match self.0 {
            Rule::Water(_) => None,
            Rule::Energy { kev, scan_kev, .. } => Some([kev, scan_kev]),
        }
    }
}

impl TryFrom<Written> for Hounsfield {
    type Error = SceneError;
    fn try_from(w: Written) -> Result<Self, SceneError> {
        let fail = |m: &str| Err(SceneError::Density(m.into()));
        match (w.mu_water, w.kev, w.scan_kev) {
            (Some(_), Some(_), _) => {
                fail("hounsfield.mu_water and hounsfield.kev contradict each other: both give the attenuation of water")
            }
            (Some(_), None, Some(_)) => {
                fail("hounsfield.scan-kev means nothing with hounsfield.mu_water; it goes with kev")
            }
            (Some(mu), None, None) => Self::of_water(mu),
            (None, Some(kev), scan) => Self::at_energy(kev, scan.unwrap_or(Self::SCAN_KEV)),
            (None, None, _) => fail("hounsfield needs kev (the photon energy) or mu_water (per mm)"),
        }
    }
}

impl From<Hounsfield> for Written {
    fn from(h: Hounsfield) -> Self {
        match h.0 {
            Rule::Water(mu) => Written { mu_water: Some(mu), ..Written::default() },
            Rule::Energy { kev, scan_kev, .. } => {
                Written { kev: Some(kev), scan_kev: Some(scan_kev), ..Written::default() }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_scan_s_own_energy_it_is_the_definition_of_the_hounsfield_unit() {
        for kev in [10.0, 33.3, 60.0, 70.0, 120.0, 500.0] {
            let (h, water) = (Hounsfield::at_energy(kev, kev).unwrap(), Substance::Water.attenuation(kev).unwrap());
            for hu in [-1024.0, -1000.0, -999.5, -998.0, -500.0, -1.0, 0.0, 1.0, 300.0, 1500.0, 3071.0] {
                let expected = water * (1.0 + hu / 1000.0);
                // The slope of air in vacuum divides rounding errors of 1000 units by about one unit.
                assert!((h.attenuation(hu) - expected).abs() < 1e-12 * water, "{kev} keV, {hu} HU");
            }
        }
    }

    #[test]
    fn substances_have_their_own_attenuation_and_everything_between_is_monotone() {
        for (kev, scan) in [(20.0, 70.0), (60.0, 70.0), (140.0, 65.0), (500.0, 40.0)] {
            let h = Hounsfield::at_energy(kev, scan).unwrap();
            let mu = |s: Substance, e: f64| s.attenuation(e).unwrap();
            for s in [Substance::Air, Substance::Water, Substance::Bone] {
                let hu = 1000.0 * (mu(s, scan) / mu(Substance::Water, scan) - 1.0);
                assert!((h.attenuation(hu) / mu(s, kev) - 1.0).abs() < 1e-9, "{s:?} at {kev} keV");
            }
            assert_eq!(h.attenuation(-1000.0), 0.0);
            assert_eq!(h.attenuation(0.0), mu(Substance::Water, kev));
            let values: Vec<f64> = (-2400..=8000).map(|i| h.attenuation(0.5 * f64::from(i))).collect();
            assert!(values.windows(2).all(|w| w[0] < w[1]), "{kev} keV");
        }
        // Bone stands out more where the photoelectric effect counts: the point of giving an energy.
        let ratio = |kev| {
            let h = Hounsfield::at_energy(kev, 70.0).unwrap();
            h.attenuation(1500.0) / h.attenuation(0.0)
        };
        assert!(ratio(30.0) > 1.5 * ratio(70.0) && ratio(150.0) < 0.85 * ratio(70.0));
    }

    #[test]
    fn energies_outside_the_tables_and_contradictions_are_refused_by_key() {
        let read = |text: &str| serde_json::from_str::<Hounsfield>(text).map_err(|e| e.to_string());
        assert_eq!(read(r#"{"kev": 60}"#), Ok(Hounsfield::at_energy(60.0, 70.0).unwrap()));
        assert_eq!(read(r#"{"mu-water": 0.02}"#), Ok(Hounsfield::of_water(0.02).unwrap()));
        for (text, words) in [
            (r#"{"kev": 5}"#, ["kev", "10 to 500"]),
            (r#"{"kev": 60, "scan-kev": 600}"#, ["scan-kev", "10 to 500"]),
            (r#"{"kev": 60, "mu_water": 0.02}"#, ["mu_water", "kev"]),
            (r#"{"scan-kev": 60, "mu_water": 0.02}"#, ["mu_water", "scan-kev"]),
            (r#"{"mu_water": 0.0}"#, ["mu_water", "positive"]),
            ("{}", ["mu_water", "kev"]),
        ] {
            let message = read(text).unwrap_err();
            assert!(words.iter().all(|w| message.contains(w)), "{text}: {message}");
        }
    }

    #[test]
    fn records_say_what_was_given() {
        let written = |h: Hounsfield| serde_json::to_string(&h).unwrap();
        assert_eq!(written(Hounsfield::of_water(0.02).unwrap()), r#"{"mu_water":0.02}"#);
        assert_eq!(written(Hounsfield::at_energy(60.0, 70.0).unwrap()), r#"{"kev":60.0,"scan-kev":70.0}"#);
    }
}
