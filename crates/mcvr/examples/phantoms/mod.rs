//! Phantoms at the sizes of scans, and where they are seen from.

pub const PHANTOMS: [&str; 8] = [
    "phantom:lobster@301x324x56",
    "phantom:lobster@96",
    "phantom:shepp-logan@256",
    "phantom:shepp-logan@80",
    "phantom:vessels@256",
    "phantom:vessels@64",
    "phantom:marschner-lobb@41",
    "phantom:ellipsoids@128",
];

/// Azimuth and elevation.
pub const VIEWS: [[f64; 2]; 3] = [[30.0, 20.0], [0.0, 0.0], [120.0, -35.0]];
