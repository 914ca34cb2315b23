//! Footprints too large for tabulated profiles: those of voxels seen from nearby, as many pixels as they are.

use crate::frame::Frame;
use crate::shape::Shape;
use crate::splat::whole;

/// Knot distances from the middle of a footprint to its end.
const REACH: f32 = 2.5;

/// Room for the profiles of one footprint.
#[derive(Default)]
pub(crate) struct Room {
    across: Vec<f32>,
    down: Vec<f32>,
}

/// The part of a profile between `0` and `end` pixels, and its first pixel.
fn profile(shape: &Shape, middle: f32, knot: f32, end: f32, out: &mut Vec<f32>) -> usize {
    out.clear();
    let first = (middle - REACH * knot).floor().clamp(0.0, end);
    let last = (middle + REACH * knot).ceil().clamp(first, end);
    let edge = |pixel: f32| shape.integral((pixel - middle) / knot);
    let mut before = edge(first);
    for n in 1..=(last - first) as usize {
        let after = edge(first + n as f32);
        out.push(after - before);
        before = after;
    }
    first as usize
}

/// Adds the footprint of a point that counts, of so many units before the factor of `line`. Returns the pixels touched, 0 where it
/// does not meet the image.
pub(crate) fn add(
    frame: &Frame,
    shapes: &[Shape; 2],
    at: [f32; 3],
    units: f32,
    image: &mut [i64],
    room: &mut Room,
) -> u64 {
    let [px, py, near, wide, high] = frame.projection.at(at);
    let width = frame.width as usize;
    // The margin is as wide as the largest tabulated footprint.
    let x = profile(&shapes[0], px + frame.side, wide, frame.width, &mut room.across);
    let y = profile(&shapes[1], py + frame.side, high, frame.height, &mut room.down);
    // Beside the image the nearest place in it stands for the voxel's centre.
    let (cx, cy) = (px.clamp(0.0, frame.width - 2.0 * frame.side), py.clamp(0.0, frame.height - 2.0 * frame.side));
    let factor = if frame.line { frame.projection.line_factor(cx, cy, near) } else { 1.0 };
    for (r, down) in room.down.iter().enumerate() {
        let row = &mut image[(y + r) * width + x..][..room.across.len()];
        let down = units * factor * down.max(0.0);
        for (sum, across) in row.iter_mut().zip(&room.across) {
            *sum = sum.wrapping_add(whole(down * across.max(0.0)));
        }
    }
    (room.across.len() * room.down.len()) as u64
}
