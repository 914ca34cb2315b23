"""The peers' phantom: the 3-D modified Shepp-Logan head, each voxel the mean of 4 x 4 x 4 point samples.

    python phantom.py N FILE.mha

A cube of 256 mm centred on the origin, N voxels along each side, unsigned 16-bit, amplitude 1 stored as 640: every mean of 64
samples of multiples of 0.1 is a whole number of those units, so that the stored phantom is exact.
"""
import math
import sys

import numpy as np

SIDE_MM = 256.0
SAMPLES = 4

# Amplitude in tenths, semi-axes a, b, c, centre x, y, z (units of half a side), rotation about z in degrees.
ELLIPSOIDS = (
    (10, 0.69, 0.92, 0.81, 0, 0, 0, 0),
    (-8, 0.6624, 0.874, 0.78, 0, -0.0184, 0, 0),
    (-2, 0.11, 0.31, 0.22, 0.22, 0, 0, -18),
    (-2, 0.16, 0.41, 0.28, -0.22, 0, 0, 18),
    (1, 0.21, 0.25, 0.41, 0, 0.35, -0.15, 0),
    (1, 0.046, 0.046, 0.05, 0, 0.1, 0.25, 0),
    (1, 0.046, 0.046, 0.05, 0, -0.1, 0.25, 0),
    (1, 0.046, 0.023, 0.05, -0.08, -0.605, 0, 0),
    (1, 0.023, 0.023, 0.02, 0, -0.606, 0, 0),
    (1, 0.023, 0.046, 0.02, 0.06, -0.605, 0, 0),
)


def samples_inside(n, ellipsoid, z, y):
    """How many of each voxel's x-samples lie inside, for the sample rows `y` of the sample plane `z`: (len(y), n)."""
    _, a, b, c, x0, y0, z0, degrees = ellipsoid
    angle = math.radians(degrees)
    # Row r of the map to the unit sphere: (r0 x + r1 y).
    rows = ((math.cos(angle) / a, math.sin(angle) / a), (-math.sin(angle) / b, math.cos(angle) / b))
    height = ((z - z0) / c) ** 2
    y = y - y0
    square = sum(r0 * r0 for r0, _ in rows)
    half = sum(r0 * r1 for r0, r1 in rows) * y
    rest = sum(r1 * r1 for _, r1 in rows) * y * y + height - 1
    root = np.sqrt(np.maximum(half * half - square * rest, 0))
    hit = half * half > square * rest
    # The numbers of the first sample inside and of the first behind; sample s lies at (s + 1/2) step - 1.
    step = 2 / (n * SAMPLES)
    number = lambda x: np.ceil((x + x0 + 1) / step - 0.5)
    first, behind = number((-half - root) / square), number((-half + root) / square)
    behind = np.where(hit, behind, first)
    voxel = SAMPLES * np.arange(n)
    until = lambda s: np.clip(s[:, None] - voxel, 0, SAMPLES)
    return (until(behind) - until(first)).astype(np.int32)


def slices(n):
    """The phantom slice by slice, (n, n) as [y, x], unsigned 16-bit."""
    fine = (np.arange(n * SAMPLES) + 0.5) * 2 / (n * SAMPLES) - 1
    for k in range(n):
        total = np.zeros((n * SAMPLES, n), np.int32)
        for z in fine[k * SAMPLES : (k + 1) * SAMPLES]:
            for ellipsoid in ELLIPSOIDS:
                if ((z - ellipsoid[6]) / ellipsoid[3]) ** 2 < 1:
                    reach = max(ellipsoid[1:3])
                    near = np.flatnonzero(np.abs(fine - ellipsoid[5]) < reach)
                    total[near] += ellipsoid[0] * samples_inside(n, ellipsoid, z, fine[near])
        yield np.maximum(total.reshape(n, SAMPLES, n).sum(1), 0).astype("<u2")


def write(n, path):
    """Writes the phantom as MetaImage."""
    spacing = SIDE_MM / n
    origin = -(n - 1) / 2 * spacing
    header = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
        f"TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = {origin} {origin} {origin}\n"
        f"ElementSpacing = {spacing} {spacing} {spacing}\nDimSize = {n} {n} {n}\n"
        "ElementType = MET_USHORT\nElementDataFile = LOCAL\n"
    )
    with open(path, "wb") as file:
        file.write(header.encode())
        for plane in slices(n):
            file.write(plane.tobytes())


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    write(int(sys.argv[1]), sys.argv[2])
