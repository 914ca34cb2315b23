//! Pixels of an image, row by row in parallel.

use mcvr_scene::Camera;
use rayon::prelude::*;

use crate::{Counters, Watch};

/// Writes `pixel(state, x, y, counters)` to every pixel of an outline `[x0, x1, y0, y1]`, with a state of its own for every row;
/// pixels beside it keep their values. `watch` hears of every row, and may stop it between pixels. Returns the work of all rows.
pub(crate) fn pixels<V: Send, S: Default>(
    values: &mut [V],
    camera: &Camera,
    [x0, x1, y0, y1]: [usize; 4],
    watch: &Watch,
    pixel: impl Fn(&mut S, usize, usize, &mut Counters) -> V + Sync,
) -> Counters {
    let rows: Vec<Counters> = values
        .par_chunks_mut(camera.extent().width)
        .enumerate()
        .with_max_len(1)
        .map(|(y, row)| {
            let (mut counters, mut state) = (Counters::default(), S::default());
            let columns = if (y0..y1).contains(&y) { x0..x1 } else { 0..0 };
            for x in columns {
                if watch.cancelled() {
                    break;
                }
                row[x] = pixel(&mut state, x, y, &mut counters);
            }
            watch.advance(1);
            counters
        })
        .collect();
    let mut counters = Counters::default();
    rows.into_iter().for_each(|c| counters += c);
    counters
}
