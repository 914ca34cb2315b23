//! Arguments for effects and for the film.

use clap::Args;
use mcvr::scene::Effects;
use mcvr::scene::effects::{Colour, DepthColour, DepthCue, LightPosition, Material, Shading, Sides, Unlisted};
use mcvr::scene::film::Film;

use super::numbers;

/// What there is on top of the plain X-ray.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Effects")]
pub struct EffectArgs {
    /// Lambert shading: one (surfaces that face the light) or two (either face) [default where given: one]
    #[arg(long, value_name = "SIDES", num_args = 0..=1, default_missing_value = "one", value_parser = sides)]
    pub shade: Option<Sides>,
    /// Dim with the distance from the light, which counts as MIN mm at least [default: a hundredth of the diagonal]
    #[arg(long, value_name = "MIN", num_args = 0..=1, default_missing_value = "auto", value_parser = depth_cue)]
    pub depth_cue: Option<DepthCue>,
    /// Where the light is: eye, X,Y,Z in world mm, or around:AZ,EL[,MM] from the volume's centre [default: eye]
    #[arg(long, value_name = "PLACE", value_parser = light, allow_hyphen_values = true)]
    pub light: Option<LightPosition>,
    /// Hue by depth, from red (near) to blue (far)
    #[arg(long, alias = "depth-color")]
    pub depth_colour: bool,
    /// Isovalues from FROM up to TO (either may be left out) in a colour, repeatable; replaces the scene's materials
    #[arg(long = "material", value_name = "FROM..TO=#rrggbb[*WEIGHT][:NAME]", value_parser = material, allow_hyphen_values = true)]
    pub materials: Vec<Material>,
    /// Isovalues in no material: colour and weight [default: left out]
    #[arg(long, value_name = "#rrggbb[*WEIGHT]", value_parser = unlisted)]
    pub unlisted: Option<Unlisted>,
}

impl EffectArgs {
    /// The effects of flags and scene; flags win.
    pub fn join(&self, mut effects: Effects) -> Effects {
        if let Some(sides) = self.shade {
            effects.shading = Some(Shading { sides });
        }
        if let Some(position) = self.light {
            effects.light.position = position;
        }
        if self.depth_colour && effects.depth_colour.is_none() {
            effects.depth_colour = Some(DepthColour::default());
        }
        if !self.materials.is_empty() {
            effects.materials.clone_from(&self.materials);
        }
        effects.depth_cue = self.depth_cue.or(effects.depth_cue);
        effects.unlisted = self.unlisted.or(effects.unlisted);
        effects
    }
}

/// What becomes of the line integrals.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Film")]
pub struct FilmArgs {
    /// A radiograph: the share exp(-line) of photons that pass; weights must be attenuations per mm (--map hounsfield)
    #[arg(long)]
    pub transmission: bool,
    /// A radiograph with the Poisson noise of N0 photons a pixel
    #[arg(long, value_name = "N0", value_parser = photons)]
    pub photons: Option<f64>,
    /// Key of the photon noise [default: the sampling seed]
    #[arg(long, value_name = "SEED")]
    pub noise_seed: Option<u64>,
}

impl FilmArgs {
    /// The film of flags and scene; flags win.
    pub fn join(&self, film: Film) -> Film {
        let asked = self.transmission || self.photons.is_some();
        Film {
            transmission: if asked { Some(true) } else { film.transmission },
            photons: self.photons.or(film.photons),
            noise_seed: self.noise_seed.or(film.noise_seed),
        }
    }
}

fn photons(text: &str) -> Result<f64, String> {
    match text.trim() {
        "0" => Ok(0.0), // refused by the film, which names its limits
        _ => numbers::count(text).map(|n| n as f64),
    }
}

fn sides(text: &str) -> Result<Sides, String> {
    match text {
        "one" => Ok(Sides::One),
        "two" => Ok(Sides::Two),
        _ => Err(format!("'{text}': one or two sides; an input file comes before --shade, or after another option")),
    }
}

fn depth_cue(text: &str) -> Result<DepthCue, String> {
    if text == "auto" {
        return Ok(DepthCue { minimum: None });
    }
    let minimum = text.parse().map_err(|_| {
        format!("'{text}' is no distance in mm; an input file comes before --depth-cue, or after another option")
    })?;
    Ok(DepthCue { minimum: Some(minimum) })
}

fn light(text: &str) -> Result<LightPosition, String> {
    let numbers = |text: &str| -> Result<Vec<f64>, String> {
        let number = |t: &str| t.trim().parse().map_err(|_| format!("'{t}' is not a number"));
        text.split(',').map(number).collect()
    };
    if text == "eye" {
        return Ok(LightPosition::Eye);
    }
    let (angles, rest) = text.strip_prefix("around:").map_or((false, text), |rest| (true, rest));
    match (angles, &numbers(rest).map_err(|e| format!("{e}; write eye, X,Y,Z or around:AZ,EL[,MM]"))?[..]) {
        (true, &[azimuth, elevation]) => Ok(LightPosition::Around { azimuth, elevation, distance: None }),
        (true, &[azimuth, elevation, d]) => Ok(LightPosition::Around { azimuth, elevation, distance: Some(d) }),
        (false, &[x, y, z]) => Ok(LightPosition::World([x, y, z])),
        _ => Err(format!("'{text}': write eye, X,Y,Z in world mm, or around:AZ,EL[,MM]")),
    }
}

fn paint(text: &str) -> Result<(Colour, f64), String> {
    let (colour, weight) = text.split_once('*').map_or((text, None), |(c, w)| (c, Some(w)));
    let weight = weight.map_or(Ok(1.0), |w| w.parse().map_err(|_| format!("'{w}' is no weight")))?;
    Ok((colour.parse()?, weight))
}

fn unlisted(text: &str) -> Result<Unlisted, String> {
    paint(text).map(|(colour, weight)| Unlisted { colour, weight })
}

fn material(text: &str) -> Result<Material, String> {
    let bad = || format!("'{text}': write FROM..TO=#rrggbb[*WEIGHT][:NAME], such as 300..=#ffffff*2:bone");
    let (range, rest) = text.split_once('=').ok_or_else(bad)?;
    let (from, to) = range.split_once("..").ok_or_else(bad)?;
    let end = |t: &str| match t.trim() {
        "" => Ok(None),
        t => t.parse().map(Some).map_err(|_| bad()),
    };
    let (rest, name) = rest.split_once(':').map_or((rest, None), |(r, n)| (r, Some(n.to_owned())));
    let (colour, weight) = paint(rest)?;
    Ok(Material { name, from: end(from)?, to: end(to)?, colour, weight })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_read() {
        let m = material("-300..120.5=#ff0000*0.5:soft tissue").unwrap();
        assert_eq!((m.from, m.to, m.weight, m.name.as_deref()), (Some(-300.0), Some(120.5), 0.5, Some("soft tissue")));
        let m = material("300..=#ffffff").unwrap();
        assert_eq!((m.from, m.to, m.weight, m.name), (Some(300.0), None, 1.0, None));
        for bad in ["", "1..2", "1-2=#ffffff", "a..2=#ffffff", "1..2=red", "1..2=#ffffff*x"] {
            assert!(material(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn lights_are_read() {
        assert_eq!(light("-1,2,3.5"), Ok(LightPosition::World([-1.0, 2.0, 3.5])));
        let around = |distance| Ok(LightPosition::Around { azimuth: 30.0, elevation: -10.0, distance });
        assert_eq!((light("around:30,-10"), light("around:30,-10,500")), (around(None), around(Some(500.0))));
        assert_eq!(light("eye"), Ok(LightPosition::Eye));
        for bad in ["", "1,2", "around:1", "sun", "around:1,2,3,4"] {
            assert!(light(bad).is_err(), "{bad}");
        }
    }
}
