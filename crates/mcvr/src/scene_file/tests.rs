use std::path::Path;

use mcvr_scene::Hounsfield;
use mcvr_scene::Transfer;
use mcvr_scene::effects::{Colour, LightPosition, Sides};

use super::SceneFile;
use crate::Method;

fn parse(text: &str) -> Result<SceneFile, super::SceneFileError> {
    SceneFile::parse(text, Path::new("s.toml"))
}

/// The error of a file, which must name the file, a line, and some words.
fn refused(text: &str, line: usize, words: &[&str]) {
    let error = parse(text).expect_err(text);
    let message = error.to_string();
    assert_eq!(error.line(), Some(line), "{text}\n{message}");
    assert!(message.starts_with(&format!("s.toml, line {line}: ")), "{message}");
    for word in words {
        assert!(message.contains(word), "no '{word}' in: {message}");
    }
    assert!(!message.contains('\n'), "one line: {message}");
}

#[test]
fn every_section_is_read() {
    let text = r##"
        [volume]
        input = "phantom:box@8"
        spacing = [1.0, 1.0, 2.0]
        [density]
        transfer = { linear = { slope = 2.0, intercept = 1.0 } }
        emphasis = { threshold = 40.0, gain = 4.0 }
        [camera]
        view = [10.0, 20.0]
        [image]
        size = [64, 48]
        kernel = "box"
        estimand = "line"
        [effects]
        light = { position = { around = { azimuth = 10.0, elevation = 20.0 } }, colour = "#ff8000", intensity = 2.0 }
        shading = { sides = "two" }
        depth-cue = { minimum = 4.0 }
        depth-colour = { range = [1.0, 2.0], stops = ["#000000", [1.0, 0.5, 0.0]] }
        unlisted = { color = "#808080", weight = 0.5 }
        [[effects.materials]]
        name = "bone"
        from = 300.0
        colour = "#ffffff"
        weight = 2.0
        [film]
        transmission = false
        [sampling]
        method = "mc-quicksort"
        order = "hilbert"
        scramble = "owen"
        [tone]
        curve = "log"
    "##;
    let scene = parse(text).unwrap();
    assert_eq!(scene.sampling.method, Some(Method::McQuicksort));
    assert_eq!(scene.density.unwrap().emphasis.unwrap().gain, 4.0);
    assert_eq!(scene.cameras[0].view, Some([10.0, 20.0]));
    let effects = scene.effects.unwrap();
    assert_eq!(effects.shading.unwrap().sides, Sides::Two);
    assert_eq!(effects.light.colour, Colour::new([1.0, 128.0 / 255.0, 0.0]).unwrap());
    assert!(matches!(effects.light.position, LightPosition::Around { distance: None, .. }));
    assert_eq!(effects.materials[0].name.as_deref(), Some("bone"));
    assert_eq!(effects.unlisted.unwrap().weight, 0.5);
    assert_eq!(effects.depth_colour.unwrap().stops.unwrap().len(), 2);
}

#[test]
fn both_spellings_of_colour_are_read_but_not_both_at_once() {
    let material = |key: &str| format!("[effects]\nmaterials = [{{ from = 1.0, {key} = \"#102030\" }}]\n");
    assert_eq!(parse(&material("colour")).unwrap(), parse(&material("color")).unwrap());
    assert!(parse("[effects]\ndepth-color = {}\nlight = { color = [1, 0, 0] }\n").unwrap().effects.is_some());
    refused(
        "[effects.light]\nintensity = 1.0\ncolour = \"#102030\"\ncolor = \"#102030\"\n",
        4,
        &["`color`", "`colour`", "two spellings"],
    );
}

#[test]
fn one_camera_or_several() {
    assert_eq!(parse("").unwrap().cameras.len(), 0);
    assert_eq!(parse("[camera]\nfov = 20\n").unwrap().cameras[0].fov, Some(20.0));
    let scene = parse("[[camera]]\nname = \"front\"\n[[camera]]\nfov = 20\n").unwrap();
    assert_eq!([scene.cameras[0].label(0), scene.cameras[1].label(1)], ["front", "2"]);
    refused("camera = []\n", 1, &["at least one"]);
    refused("[[camera]]\nname = \"2\"\n[[camera]]\nfov = 20\n", 3, &["both called", "\"2\""]);
    refused("[[camera]]\nname = \"../x\"\n", 2, &["camera.name", "letters"]);
}

#[test]
fn unknown_keys_are_named_with_line_and_nearest_key_at_every_level() {
    refused("[image]\nsizes = [1, 2]\n", 2, &["`sizes`", "[image]", "did you mean `size`", "kernel", "estimand"]);
    refused("\n\n[volume]\ninput = \"x\"\nspacng = [1, 1, 1]\n", 5, &["did you mean `spacing`", "dims", "endian"]);
    refused("# a comment\n[efects]\n", 2, &["top level", "did you mean `effects`", "sampling"]);
    refused("[effects]\ndepth_cu = {}\n", 2, &["did you mean `depth-cue`"]);
    // Nothing is near: the list stands alone.
    let message = parse("[image]\nqqqqqq = 1\n").unwrap_err().to_string();
    assert!(!message.contains("did you mean") && message.contains("valid keys: size, kernel, estimand"), "{message}");
    // Inline tables inside inline tables, over several lines of an array.
    let materials = "[effects]\nmaterials = [\n  { from = 1.0, to = 2.0, colour = \"#112233\" },\n  { from = 3.0, \
                     wieght = 2.0, colour = \"#112233\" },\n]\n";
    refused(materials, 4, &["`wieght`", "[effects.materials]", "did you mean `weight`"]);
    let light = "[effects.light]\nintensity = 1\nposition = { around = { azimuth = 1, elevaton = 2 } }\n";
    refused(light, 3, &["`elevaton`", "[effects.light.position.around]", "did you mean `elevation`", "azimuth"]);
    refused("[density]\ntransfer = { linear = { slop = 2.0 } }\n", 2, &["did you mean `slope`", "intercept"]);
    refused("[density]\ntransfer = { hounsfield = { kv = 60 } }\n", 2, &["did you mean `kev`", "scan-kev"]);
    // The second table of an array of tables.
    refused("[[camera]]\nview = [1, 2]\n[[camera]]\nveiw = [1, 2]\n", 4, &["`veiw`", "[camera]", "`view`"]);
    let second = "[[effects.materials]]\ncolour = \"#112233\"\nto = 1.0\n[[effects.materials]]\ncolour = \"#112233\"\nform = 1.0\n";
    refused(second, 6, &["`form`", "did you mean `from`"]);
    // Advertised once, in one spelling.
    let message = parse("[effects.light]\ncolur = 1\n").unwrap_err().to_string();
    assert!(message.contains("`colour`") && !message.contains("color"), "{message}");
}

#[test]
fn wrong_values_are_named_with_line_and_nearest_value() {
    refused(
        "[image]\nsize = [3, 4]\nkernel = \"tant\"\n",
        3,
        &["`tant`", "image.kernel", "did you mean `tent`", "box"],
    );
    refused("[sampling]\nmethod = \"qcm\"\n", 2, &["sampling.method", "did you mean `qmc`", "stratified"]);
    refused("[effects]\nshading = { sides = \"tow\" }\n", 2, &["effects.shading.sides", "did you mean `two`"]);
    refused("[density]\ntransfer = \"idenity\"\n", 2, &["did you mean `identity`", "hounsfield"]);
    refused("[effects.light]\nposition = \"eyes\"\n", 2, &["did you mean `eye`", "around"]);
    refused("[effects.light]\n\ncolour = \"red\"\n", 3, &["effects.light.colour", "#rrggbb"]);
    refused("[effects.light]\ncolour = [1, 2]\n", 2, &["effects.light.colour", "[red, green, blue]"]);
    refused("[image]\nsize = [3]\n", 2, &["image.size"]);
    refused("[image]\nsize = [0, 4]\n", 2, &["image.size", "2^30"]);
    refused("[camera]\nfov = \"wide\"\n", 2, &["camera.fov", "wide"]);
    refused("[camera]\nview = [0, 0]\nfov = 180\n", 3, &["camera.fov", "180"]);
    refused("[tone]\nwindow = [50, 20]\n", 2, &["tone.window", "percentiles"]);
    refused("[density]\nemphasis = { threshold = 4.0 }\n", 2, &["missing key `gain`", "density.emphasis"]);
    refused("[density]\ntransfer = { piecewise = [[2, 0], [1, 0]] }\n", 2, &["piecewise", "rise"]);
    refused("[effects]\ndepth-cue = { minimum = 0.0 }\n", 2, &["depth-cue.minimum", "positive"]);
    refused("[image]\nkernel = tent\n", 2, &[]);
    refused("[image]\nkernel = \"box\"\nkernel = \"tent\"\n", 3, &["duplicate key"]);
}

#[test]
fn contradictions_name_both_keys() {
    let matrix = "matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 9]]\n";
    refused(&format!("[camera]\n{matrix}view = [1, 2]\n"), 3, &["camera.matrix", "camera.view"]);
    refused(&format!("[[camera]]\nfov = 9\n[[camera]]\n{matrix}fov = 9\n"), 5, &["camera.matrix", "camera.fov"]);
    let count = "[image]\nestimand = \"count\"\n";
    refused(&format!("{count}[film]\ntransmission = true\n"), 4, &["film.transmission", "image.estimand"]);
    refused(&format!("{count}[film]\nphotons = 1000\n"), 4, &["film.photons", "image.estimand"]);
    refused("[film]\ntransmission = false\nphotons = 1000\n", 3, &["film.photons", "film.transmission"]);
    refused("[film]\ntransmission = true\nnoise-seed = 3\n", 3, &["film.noise-seed", "film.photons"]);
    refused("[film]\nphotons = 0\n", 2, &["film.photons", "between 1 and 1e15", "got 0"]);
    refused("[film]\nphotons = 9\n[effects]\nshading = {}\n", 2, &["film.photons", "effects.shading"]);
    refused("[effects]\n\nunlisted = { weight = 1.0 }\n", 3, &["unlisted", "materials"]);
    refused("[camera]\nparallel = true\n[effects]\nshading = {}\n", 4, &["effects.shading", "camera.parallel"]);
    let cue = "[[camera]]\n[[camera]]\nparallel = true\n[effects.depth-cue]\n";
    refused(cue, 4, &["effects.depth-cue", "camera.parallel", "light.position"]);
    assert!(parse("[camera]\nparallel = true\n[effects]\ndepth-colour = {}\n").is_ok(), "no light, no contradiction");
    let hounsfield = "[density.transfer]\nhounsfield = { kev = 60.0, mu-water = 0.02 }\n";
    refused(hounsfield, 2, &["hounsfield.mu_water", "hounsfield.kev"]);
    let overlap =
        "[effects]\nmaterials = [{ from = 1.0, colour = \"#ffffff\" }, { from = 2.0, colour = \"#ffffff\" }]\n";
    refused(overlap, 2, &["overlap"]);
}

#[test]
fn an_error_that_is_enough_is_read_and_unusable_ones_are_named() {
    let scene =
        parse("[error]\nrmse = 0.02\npixel = { error = 0.1 }\nconfidence = 0.9\ntime = 5\nreplicates = 16\n").unwrap();
    assert_eq!((scene.error.rmse, scene.error.time, scene.error.replicates), (Some(0.02), Some(5.0), Some(16)));
    assert_eq!(scene.error.pixel.unwrap().goal().share, 0.95);
    refused("[error]\nrmse = 0\n", 2, &["error.rmse", "positive"]);
    refused("[error]\npixel = { error = 0.1, share = 1.0 }\n", 2, &["error.pixel", "less than 1"]);
    refused("[error]\nconfidence = 95\n", 2, &["error.confidence", "0.9999"]);
    refused("[error]\ntime = -1.0\n", 2, &["error.time", "seconds"]);
    refused("[error]\nreplicates = 9\n", 2, &["error.replicates", "8, 16, 32 or 64"]);
    refused("[error]\nrsme = 0.1\n", 2, &["did you mean `rmse`"]);
}

#[test]
fn hounsfield_units_take_an_energy() {
    let transfer = |text: &str| parse(&format!("[density]\ntransfer = {text}\n")).unwrap().density.unwrap().transfer;
    let at = |kev, scan| Transfer::Hounsfield(Hounsfield::at_energy(kev, scan).unwrap());
    assert_eq!(transfer("{ hounsfield = { kev = 60 } }"), at(60.0, 70.0));
    assert_eq!(transfer("{ hounsfield = { kev = 60.0, scan-kev = 65.0 } }"), at(60.0, 65.0));
    let water = Transfer::Hounsfield(Hounsfield::of_water(0.02).unwrap());
    assert_eq!(transfer("{ hounsfield = { mu_water = 0.02 } }"), water);
    refused("[density]\ntransfer = { hounsfield = { kev = 5 } }\n", 2, &["kev", "10 to 500", "got 5"]);
}

#[test]
fn orders_have_the_names_of_the_command_line_and_those_of_records() {
    use mcvr_sampling::VoxelOrder;
    let read = |name: &str| parse(&format!("[sampling]\norder = \"{name}\"\n")).unwrap().sampling.order.unwrap();
    for (name, order) in VoxelOrder::ALL {
        assert_eq!(read(name), order);
        assert_eq!(read(serde_json::to_value(order).unwrap().as_str().unwrap()), order);
    }
    refused("[sampling]\nseed = 1\norder = \"x\"\n", 3, &["`x`", "raster", "hilbert", "depth"]);
    refused("[sampling]\norder = 3\n", 2, &["order"]);
    assert_eq!(parse("[sampling]\ncull = false\n").unwrap().sampling.cull, Some(false));
}
