use super::*;

fn extent(width: usize, height: usize) -> Extent {
    Extent::new(width, height).unwrap()
}

fn image(width: usize, height: usize, of: impl Fn(usize, usize) -> f64) -> Image {
    let values = (0..width * height).map(|i| of(i % width, i / width)).collect();
    Image::from_values(extent(width, height), values).unwrap()
}

fn whole() -> Tone {
    Tone { window: [0.0, 100.0], ..Tone::default() }
}

fn preview(palette: Palette) -> Preview {
    Preview { term: Term::stderr(), palette, last: None }
}

/// What a terminal would show: per line, the foreground and background codes of each cell.
fn cells(lines: &[String]) -> Vec<Vec<[String; 2]>> {
    let of_line = |line: &String| {
        let body = line.strip_suffix("\x1b[0m").expect("a line ends by a reset");
        assert!(!body.contains("\x1b[0m"), "and has no other");
        let mut cells = vec![];
        for piece in body.split("\x1b[").skip(1) {
            let (codes, blocks) = piece.split_once('m').unwrap();
            let codes: Vec<&str> = codes.split(';').collect();
            let (above, below) = codes.split_at(if codes[1] == "2" { 5 } else { 3 });
            assert!(above[0] == "38" && ["48", "49"].contains(&below[0]), "{codes:?}");
            let colours = [above.join(";"), below.join(";")];
            assert!(blocks.chars().all(|c| c == '▀'), "{blocks}");
            cells.extend(blocks.chars().map(|_| colours.clone()));
        }
        cells
    };
    lines.iter().map(of_line).collect()
}

fn environment(pairs: &[(&str, &str)]) -> Option<Palette> {
    Palette::of(|name| pairs.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned()))
}

#[test]
fn a_terminal_says_in_its_environment_what_it_shows() {
    let xterm = ("TERM", "xterm-256color");
    let rich = ("COLORTERM", "truecolor");
    assert_eq!(environment(&[xterm, rich]), Some(Palette::True));
    assert_eq!(environment(&[xterm]), Some(Palette::Indexed));
    assert_eq!(environment(&[("TERM", "xterm-kitty")]), Some(Palette::True));
    assert_eq!(environment(&[("TERM", "screen-256color"), rich]), Some(Palette::Indexed));
    assert_eq!(environment(&[xterm, rich, ("NO_COLOR", "")]), Some(Palette::True), "an empty NO_COLOR asks nothing");
    for none in [&[][..], &[("TERM", "dumb"), rich], &[xterm, rich, ("NO_COLOR", "1")], &[rich], &[("TERM", "vt100")]] {
        assert_eq!(environment(none), None, "{none:?}");
    }
}

#[test]
fn quiet_and_pipes_get_no_preview() {
    assert!(Preview::new(true).is_none());
    // Tests may run in a terminal; what is no terminal is told apart here only where they do not.
    if !Term::stderr().is_term() {
        assert!(Preview::new(false).is_none());
    }
}

#[test]
fn an_image_fits_the_terminal_and_keeps_its_shape() {
    let fits = |w, h, columns, rows| {
        let Extent { width, height } = fitted(extent(w, h), columns, rows).unwrap();
        (width, height)
    };
    assert_eq!(fits(400, 400, 200, 100), (80, 80), "no wider than 80");
    assert_eq!(fits(400, 400, 200, 24), (42, 42), "no higher than the terminal less three lines");
    assert_eq!(fits(400, 200, 61, 100), (60, 30), "the last column stays free");
    assert_eq!(fits(16, 9, 200, 100), (16, 9), "never larger than it is");
    assert_eq!(fits(10_000, 1, 80, 24), (79, 1));
    assert_eq!(fits(1, 10_000, 80, 24), (1, 42));
    for (columns, rows) in [(0, 0), (1, 1), (2, 3)] {
        let (width, height) = fits(640, 480, columns, rows);
        assert!(width == 1 && (1..=2).contains(&height));
    }
}

#[test]
fn shrinking_takes_the_mean_over_each_area() {
    let ramp = image(6, 4, |x, y| (x + 10 * y) as f64);
    let half = shrunk(&ramp, extent(3, 2)).unwrap();
    assert_eq!(half.values(), [5.5, 7.5, 9.5, 25.5, 27.5, 29.5]);
    for (w, h) in [(1, 1), (4, 3), (5, 2), (6, 4), (2, 4)] {
        let small = shrunk(&ramp, extent(w, h)).unwrap();
        assert!((small.mean() - ramp.mean()).abs() < 1e-12, "{w}x{h} keeps the mean");
    }
    // Two thirds of a pixel and a third of the next.
    let line = shrunk(&image(3, 1, |x, _| [3.0, 6.0, 9.0][x]), extent(2, 1)).unwrap();
    assert!((line.get(0, 0) - 4.0).abs() < 1e-12 && (line.get(1, 0) - 8.0).abs() < 1e-12);
}

#[test]
fn a_drawing_has_two_rows_a_line_and_a_cell_a_column() {
    for (width, height) in [(5, 4), (5, 3), (1, 1), (80, 7)] {
        let lines = drawn(&[image(width, height, |x, y| (x * y) as f64)], &whole(), Palette::True);
        let cells = cells(&lines);
        assert_eq!(cells.len(), height.div_ceil(2));
        assert!(cells.iter().all(|line| line.len() == width));
        let last = &cells[cells.len() - 1];
        assert_eq!(last.iter().all(|[_, below]| below == "49"), height % 2 == 1, "nothing below an odd row");
    }
}

#[test]
fn brighter_values_are_brighter_in_both_palettes() {
    let ramp = image(26, 1, |x, _| x as f64);
    for palette in [Palette::True, Palette::Indexed] {
        let cells = cells(&drawn(std::slice::from_ref(&ramp), &whole(), palette));
        let level = |cell: &[String; 2]| -> u32 {
            let last: u32 = cell[0].rsplit(';').next().unwrap().parse().unwrap();
            // In the cube 16 is black and 231 white; the greys between them come after.
            match (palette, last) {
                (Palette::Indexed, 16) => 0,
                (Palette::Indexed, 231) => 256,
                _ => last,
            }
        };
        let levels: Vec<u32> = cells[0].iter().map(level).collect();
        assert!(levels.windows(2).all(|w| w[0] < w[1]), "{palette:?}: {levels:?}");
    }
    let inverted = drawn(&[ramp], &Tone { invert: true, ..whole() }, Palette::True);
    assert!(inverted[0].starts_with("\x1b[38;2;255;255;255;49m▀"));
}

#[test]
fn colours_are_shown_as_they_are_and_their_nearest_of_the_cube() {
    let red = [image(1, 2, |_, y| [4.0, 2.0][y]), image(1, 2, |_, _| 0.0), image(1, 2, |_, _| 0.0)];
    assert_eq!(
        drawn(&red, &Tone { window: [0.0, 100.0], ..Tone::default() }, Palette::True),
        ["\x1b[38;2;255;0;0;48;2;0;0;0m▀\x1b[0m"]
    );
    // xterm's cube has the levels 0, 95, 135, 175, 215, 255.
    let steps = [0, 95, 135, 175, 215, 255];
    for value in 0..=255u8 {
        let nearest = (0..6).min_by_key(|i| (steps[*i] - i32::from(value)).abs()).unwrap();
        let code = Palette::Indexed.code([value, 0, 1]);
        let index: usize = code.strip_prefix("5;").unwrap().parse().unwrap();
        let found = (index - 16) / 36;
        let off = |i: usize| (steps[i] - i32::from(value)).abs();
        assert_eq!(off(found), off(nearest), "{value}");
    }
}

#[test]
fn a_drawing_goes_over_the_last_unless_the_terminal_changed_or_it_was_left() {
    let picture = [image(8, 6, |x, y| (x + y) as f64)];
    let mut preview = preview(Palette::True);
    let frame = |preview: &mut Preview, size| preview.frame(&picture, &whole(), "pass 1", size).unwrap();
    let first = frame(&mut preview, (24, 80));
    assert!(first.starts_with("\x1b[38;") && first.ends_with("pass 1\x1b[K\n\x1b[J"), "{first:?}");
    assert_eq!(first.matches('\n').count(), 4, "three lines of two rows, and the caption");
    let second = frame(&mut preview, (24, 80));
    assert_eq!(second, format!("\x1b[4A\r{first}"));
    assert_eq!(frame(&mut preview, (24, 70)), first, "a terminal of another size");
    preview.leave();
    assert_eq!(frame(&mut preview, (24, 70)), first, "left");
}

#[test]
fn a_caption_cannot_break_out_of_its_line_and_odd_images_are_safe() {
    let mut preview = preview(Palette::Indexed);
    let dark = [image(3, 2, |_, _| 0.0)];
    let text = preview.frame(&dark, &Tone::default(), "a\nb\x1b[2Jc and much more", (24, 10)).unwrap();
    assert!(text.contains("\nab[2Jc an\x1b[K\n"), "{text:?}");
    for value in [f64::NAN, f64::INFINITY, -1e308] {
        let odd = [image(3, 2, |x, _| if x == 1 { value } else { 1.0 })];
        assert!(preview.frame(&odd, &Tone::default(), "", (24, 80)).is_ok());
    }
    assert_eq!(preview.frame(&[], &Tone::default(), "", (24, 80)).unwrap(), "");
}
