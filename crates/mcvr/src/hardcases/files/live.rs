//! Files that change while they are used, are used twice, and voxels that only look like numbers.

use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;

use mcvr_harness::record::RecordLog;
use mcvr_volume::{
    Endian, Grid, RawOptions, Summary, Volume, VoxelType, Voxels, byte_order_suspicion, open, write_nrrd,
};

use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{Tally, place, print_of};
use super::good::{GoodFile, good_files, print_volume};

pub(super) const CASES: &[Case] = &[
    case(
        "file-replaced-while-mapped",
        "a file that is replaced, removed or grown under a running program changes the image half-way",
        "a mapped volume keeps every voxel while its file is replaced by renaming, removed, or grown",
        replaced,
    ),
    case(
        "file-shortened-while-mapped",
        "a file that is cut short under a running program gives zeros for the rest",
        "the program ends with the right figures, an error, or the system's bus error; never with wrong figures",
        shortened,
    ),
    case(
        "file-opened-twice",
        "two readers share one position in the file, or two runs write one log",
        "sixteen readings at once of every good file agree; a log that is being written is refused",
        twice,
    ),
    case(
        "file-voxels-not-numbers",
        "NaN and infinite voxels change in reading, or spoil the mean and the histogram",
        "each of them is read bit by bit, counted, and left out of minimum, maximum and mean",
        not_numbers,
    ),
    case(
        "file-byte-order",
        "bytes in the wrong order give noise that looks like a scan of noise",
        "smooth integers read in the wrong order are reported, in the right order they are not",
        byte_order,
    ),
];

/// The good file whose voxels are used where they lie.
fn mapped(files: &[GoodFile]) -> Result<&GoodFile, CaseError> {
    Ok(files.iter().find(|g| g.format == "NRRD").ok_or("no NRRD")?)
}

/// Exact: a map belongs to the file itself, not to its name, and ends where the file ended when it was made.
fn replaced(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let files = good_files(folder.path())?;
    let good = mapped(&files)?;
    let path = place(good, folder.path())?;
    let mut total = Tally::default();
    for what in ["replaced by renaming", "removed", "grown"] {
        let print = print_of(good, &path)?;
        let volume = open(&path, None)?.volume;
        total.check("the good file is not mapped", volume.voxels().is_mapped());
        match what {
            "removed" => std::fs::remove_file(&path)?,
            "grown" => std::fs::File::options().append(true).open(&path)?.write_all(&[9; 100_000])?,
            _ => {
                std::fs::write(folder.path().join("new"), b"short")?;
                std::fs::rename(folder.path().join("new"), &path)?;
            }
        }
        total.check(what, print_volume(&volume) == print);
    }
    Ok(total.finding("checks", "overwriting in place shows through: the file's voxels are the volume's"))
}

/// Exact. A map cannot be read behind the end of a file that was shortened: the system ends the process (SIGBUS, 7 on
/// Linux, 10 elsewhere). Catching that would take a signal handler, which the program does not have; what is asserted is
/// that nothing worse happens, above all no zeros in place of voxels.
fn shortened(context: &Context) -> Result<Finding, CaseError> {
    let program = context.program()?;
    let folder = context.folder()?;
    let mut total = Tally::default();
    let (mut right, mut error, mut bus) = (0, 0, 0);
    for wait in [0, 2, 5, 10, 20, 40, 80, 160] {
        let path = folder.path().join("scan_256x256x256_uint8.raw");
        std::fs::write(&path, vec![7u8; 1 << 24])?;
        let child = Command::new(program)
            .args(["--threads", "1", "info"])
            .arg(&path)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        std::thread::sleep(Duration::from_millis(wait));
        std::fs::File::options().write(true).open(&path)?.set_len(1 << 14)?;
        let out = child.wait_with_output()?;
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        let fine = match (out.status.code(), signal(&out.status)) {
            (Some(0), _) => {
                right += 1;
                text.contains("values       7 .. 7, mean 7.0")
            }
            (Some(1), _) => {
                error += 1;
                String::from_utf8_lossy(&out.stderr).contains("scan_256x256x256")
            }
            (_, Some(7 | 10)) => {
                bus += 1;
                true
            }
            _ => false,
        };
        total.check(&format!("shortened after {wait} ms: {:?} {text}", out.status), fine);
        std::fs::remove_file(&path)?;
    }
    let detail = format!("{right} finished before, {error} with an error, {bus} ended by the system");
    Ok(total.finding("runs", &detail))
}

#[cfg(unix)]
fn signal(status: &std::process::ExitStatus) -> Option<i32> {
    std::os::unix::process::ExitStatusExt::signal(status)
}

#[cfg(not(unix))]
fn signal(_: &std::process::ExitStatus) -> Option<i32> {
    None
}

/// Exact.
fn twice(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in good_files(folder.path())? {
        let path = place(&good, folder.path())?;
        let print = print_of(&good, &path)?;
        let same = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..16).map(|_| scope.spawn(|| good.reader.read(&path))).collect();
            threads.into_iter().filter_map(|t| t.join().ok()).filter(|p| p.as_ref() == Ok(&print)).count()
        });
        total.check(&format!("{}: {same} of 16 readings agree", good.format), same == 16);
        std::fs::remove_file(&path)?;
    }
    let path = folder.path().join("log.jsonl");
    let first = RecordLog::open(&path)?;
    let second = RecordLog::open(&path).err().map(|e| e.to_string()).unwrap_or_default();
    total.check("a second log", second.contains("another run") && second.contains("log.jsonl"));
    drop(first);
    total.check("a log after the first", RecordLog::open(&path).is_ok());
    Ok(total.finding("checks", ""))
}

/// Exact. The mean is of 58 numbers 0 … 57 in `f64`: every partial sum is a whole number.
fn not_numbers(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let path = folder.path().join("a.nrrd");
    let grid = Grid::with_spacing([8, 8, 1], [1.0; 3])?;
    let mut total = Tally::default();
    let mut pose = |volume: Volume| -> Result<(), CaseError> {
        write_nrrd(&volume, &path)?;
        let back = open(&path, None)?.volume;
        let same = match (volume.voxels(), back.voxels()) {
            (Voxels::F32(a), Voxels::F32(b)) => a.iter().zip(b.iter()).all(|(a, b)| a.to_bits() == b.to_bits()),
            (Voxels::F64(a), Voxels::F64(b)) => a.iter().zip(b.iter()).all(|(a, b)| a.to_bits() == b.to_bits()),
            _ => false,
        };
        let s = Summary::of(&back);
        total.check("bits", same);
        total.check("counts", (s.nan, s.infinite) == (4, 2));
        total.check("minimum and maximum", (s.min, s.max) == (0.0, 57.0));
        total.check("mean", s.mean == 28.5);
        total.check("histogram", s.histogram.iter().sum::<u64>() == 58);
        Ok(())
    };
    // Quiet, signalling and negative NaNs, with payloads.
    let mut single: Vec<f32> = [0x7fc0_0000, 0x7f80_0001, 0xffc1_2345, 0x7fff_ffff].map(f32::from_bits).to_vec();
    single.extend([f32::INFINITY, f32::NEG_INFINITY]);
    single.extend((0..58u8).map(f32::from));
    let quiet = 0x7ff8_0000_0000_0000u64;
    let mut double: Vec<f64> =
        [quiet, 0x7ff0_0000_0000_0001, quiet | 1 << 63 | 5, u64::MAX].map(f64::from_bits).to_vec();
    double.extend([f64::INFINITY, f64::NEG_INFINITY]);
    double.extend((0..58u8).map(f64::from));
    pose(Volume::from_vec(grid.clone(), single, "a")?)?;
    pose(Volume::from_vec(grid, double, "a")?)?;
    Ok(total.finding("checks", ""))
}

/// Exact: on a ramp of 4 a voxel over 1,024 voxels, neighbours differ by 1/1023 of the range; swapped, the low byte leads
/// and steps by 4/256 or more of it, sixteen times as much, where the test asks for three.
fn byte_order(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let path = folder.path().join("a.raw");
    let mut total = Tally::default();
    let ramp = |n: u32| 4 * (n % 1024);
    for (voxel_type, bytes) in
        [(VoxelType::U16, 2), (VoxelType::I16, 2), (VoxelType::U32, 4), (VoxelType::I32, 4), (VoxelType::F32, 4)]
    {
        let big = |n: u32| match voxel_type {
            VoxelType::F32 => (ramp(n) as f32).to_be_bytes().to_vec(),
            _ => ramp(n).to_be_bytes()[4 - bytes..].to_vec(),
        };
        std::fs::write(&path, (0..4096).flat_map(big).collect::<Vec<u8>>())?;
        for endian in [Endian::Big, Endian::Little] {
            let (voxel_type, endian) = (Some(voxel_type), Some(endian));
            let options = RawOptions { dims: Some([1024, 2, 2]), voxel_type, endian, ..RawOptions::default() };
            let told = byte_order_suspicion(&open(&path, Some(&options))?.volume).is_some();
            total.check(&format!("{voxel_type:?} read as {endian:?}"), told == (endian == Some(Endian::Little)));
        }
    }
    Ok(total.finding("readings", "floats are told by values that no scan has"))
}
