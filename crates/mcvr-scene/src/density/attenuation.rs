//! Published X-ray attenuation of the substances that Hounsfield units are mixed from.
//!
//! Mass attenuation coefficients with coherent scattering, cm²/g: J. H. Hubbell and S. M. Seltzer, *Tables of X-Ray Mass
//! Attenuation Coefficients and Mass Energy-Absorption Coefficients*, NISTIR 5632, NIST Standard Reference Database 126
//! (<https://www.nist.gov/pml/x-ray-mass-attenuation-coefficients>), table 4: "Water, Liquid", "Air, Dry (near sea
//! level)", "Bone, Cortical (ICRU-44)"; densities from its table 2. None of the three has an absorption edge above
//! 10 keV, so the logarithm interpolates well over the logarithm of the energy.

/// A substance with tabulated attenuation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Substance {
    /// Liquid water, 1 g/cm³.
    Water,
    /// Dry air near sea level, 1.205 mg/cm³.
    Air,
    /// Cortical bone of ICRU report 44, 1.92 g/cm³.
    Bone,
}

/// Photon energies of the table in keV.
const ENERGIES: [f64; 14] = [10., 15., 20., 30., 40., 50., 60., 80., 100., 150., 200., 300., 400., 500.];

const WATER: [f64; 14] =
    [5.329, 1.673, 0.8096, 0.3756, 0.2683, 0.2269, 0.2059, 0.1837, 0.1707, 0.1505, 0.1370, 0.1186, 0.1061, 0.09687];

const AIR: [f64; 14] =
    [5.120, 1.614, 0.7779, 0.3538, 0.2485, 0.2080, 0.1875, 0.1662, 0.1541, 0.1356, 0.1233, 0.1067, 0.09549, 0.08712];

const BONE: [f64; 14] =
    [28.51, 9.032, 4.001, 1.331, 0.6655, 0.4242, 0.3148, 0.2229, 0.1855, 0.1480, 0.1309, 0.1113, 0.09908, 0.09022];

impl Substance {
    /// Smallest and largest photon energy of the tables, in keV.
    pub const LIMITS: [f64; 2] = [ENERGIES[0], ENERGIES[13]];

    /// Density in g/cm³.
    pub fn density(self) -> f64 {
        match self {
            Substance::Water => 1.0,
            Substance::Air => 1.205e-3,
            Substance::Bone => 1.92,
        }
    }

    /// Mass attenuation coefficient in cm²/g at a photon energy in keV: a straight line between the table's logarithms.
    /// `None` outside [`Substance::LIMITS`].
    pub fn mass_attenuation(self, kev: f64) -> Option<f64> {
        let [low, high] = Self::LIMITS;
        if !(low..=high).contains(&kev) {
            return None;
        }
        let table = match self {
            Substance::Water => &WATER,
            Substance::Air => &AIR,
            Substance::Bone => &BONE,
        };
        let i = ENERGIES.partition_point(|e| *e <= kev).clamp(1, ENERGIES.len() - 1) - 1;
        let t = (kev / ENERGIES[i]).ln() / (ENERGIES[i + 1] / ENERGIES[i]).ln();
        Some(table[i] * (table[i + 1] / table[i]).powf(t))
    }

    /// Linear attenuation per mm at a photon energy in keV; `None` outside [`Substance::LIMITS`].
    pub fn attenuation(self, kev: f64) -> Option<f64> {
        self.mass_attenuation(kev).map(|m| m * self.density() * 0.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_the_published_values_and_lines_between_them_are_straight_in_logarithms() {
        for (substance, kev, value) in [
            (Substance::Water, 10.0, 5.329),
            (Substance::Water, 60.0, 0.2059),
            (Substance::Water, 500.0, 0.09687),
            (Substance::Air, 100.0, 0.1541),
            (Substance::Bone, 60.0, 0.3148),
            (Substance::Bone, 500.0, 0.09022),
        ] {
            let got = substance.mass_attenuation(kev).unwrap();
            assert!((got / value - 1.0).abs() < 1e-14, "{substance:?} at {kev} keV: {got}");
        }
        // The geometric middle of an interval has the geometric mean.
        let middle = Substance::Bone.mass_attenuation((60.0f64 * 80.0).sqrt()).unwrap();
        assert!((middle / (0.3148f64 * 0.2229).sqrt() - 1.0).abs() < 1e-14);
        assert!((Substance::Water.attenuation(60.0).unwrap() - 0.02059).abs() < 1e-16);
    }

    #[test]
    fn attenuation_falls_with_energy_and_rises_with_density_of_the_substance() {
        let mut last = [f64::INFINITY; 3];
        for step in 0..=490 {
            let kev = 10.0 + f64::from(step);
            let now = [Substance::Air, Substance::Water, Substance::Bone].map(|s| s.attenuation(kev).unwrap());
            assert!(now[0] < now[1] && now[1] < now[2], "{kev}");
            assert!(now.iter().zip(last).all(|(a, b)| *a < b), "{kev}");
            last = now;
        }
    }

    #[test]
    fn energies_outside_the_table_have_no_value() {
        for kev in [9.99, 500.01, f64::NAN, -60.0, f64::INFINITY] {
            assert_eq!(Substance::Water.attenuation(kev), None, "{kev}");
        }
    }
}
