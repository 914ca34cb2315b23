//! Threads and memory: none, too many, refused by the system.

use super::program::{Place, finish};
use super::{Case, CaseError, Context, Finding, Tally, picture, quick};

pub(super) const CASES: &[Case] = &[
    quick(
        "threads-out-of-range",
        "0 threads hang or mean something else, a number too large wraps round",
        "exit 2, the flag and the value named",
        threads_out_of_range,
    ),
    quick(
        "a-thousand-threads",
        "more threads than blocks of samples: some sums are lost, or the seed depends on the thread",
        "images by 1000 and 1024 threads have the bits of one thread's",
        a_thousand_threads,
    ),
    quick(
        "threads-refused",
        "a thread that the system refuses is a panic in the middle of the work",
        "exit 1 and words, whether the number came from a flag, the environment or the processors",
        threads_refused,
    ),
    quick(
        "memory-refused",
        "an allocation that fails ends the process with a signal and no word of what to do",
        "exit 1 before the work, what takes how many bytes and how many are free",
        memory_refused,
    ),
];

/// Exact: six values that are no number of threads.
fn threads_out_of_range(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    for value in ["0", "-1", "1025", "65536", "18446744073709551616", "two"] {
        let threads = format!("--threads={value}");
        let ended = place.run(picture(&["-o", "a.png", &threads]))?;
        let clear = ended.failed_with(2, &["--threads", value]) && !place.path("a.png").exists();
        tally.check(clear, || format!("{value}: {}", ended.last_words()));
    }
    Ok(tally.finding("values", "0, -1, 1025, 2^16, 2^64, a word"))
}

/// Exact: bytes of linear images of both estimands, 2^16 samples: 32 blocks for 1024 threads.
fn a_thousand_threads(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    for (estimand, many) in [("line", "1000"), ("count", "1024")] {
        let image = |threads: &str| -> Result<Vec<u8>, CaseError> {
            place.must(picture(&["--estimand", estimand, "-o", "a.npy", "--threads", threads]))?;
            Ok(std::fs::read(place.path("a.npy"))?)
        };
        let one = image("1")?;
        for threads in ["2", many] {
            let same = image(threads)? == one;
            tally.check(same, || format!("{estimand} by {threads} threads differs"));
        }
    }
    Ok(tally.finding("images", "line by 1, 2 and 1000 threads, count by 1, 2 and 1024"))
}

/// Exact: of a thousand threads a user who may have three processes gets two at most, whoever asks for them. (A small address
/// space would refuse threads as well, but those that have started may then find no memory for themselves.)
fn threads_refused(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let user = place.unprivileged()?;
    let mut tally = Tally::default();
    let ways = [("a flag", "", " --threads 1000"), ("the environment", "export RAYON_NUM_THREADS=1000; ", "")];
    for (way, before, after) in ways {
        // Shells differ in the letter.
        let limit = "ulimit -u 3 2>/dev/null || ulimit -p 3 2>/dev/null || exit 77";
        let script = format!("{before}{limit}; exec {user} \"$@\"{after}");
        let ended = finish(place.shell(&script, picture(&["-o", "a.png"])))?;
        if ended.code() == Some(77) {
            return Err(CaseError::Impossible("no limit to a user's processes here".into()));
        }
        let clear = ended.failed_with(1, &["cannot start", "threads"]) && !place.path("a.png").exists();
        tally.check(clear, || format!("{way}: {}", ended.last_words()));
    }
    Ok(tally.finding("ways to ask", "1000 threads for a user who may have 3 processes"))
}

/// Exact: seven things that cannot fit into an address space of 600 MB: images of 10⁸ and of 2^30 pixels take 8 bytes a pixel and more,
/// a point 12, a target to sort 8, a frame
/// of an animation 1 a pixel. Each must be refused in words; samples are 2^40, so that an error after the work
/// would not come.
fn memory_refused(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    place.must(["sample", "phantom:lobster@24", "--samples", "2^10", "-o", "cloud.mcvr"])?;
    let mut tally = Tally::default();
    let phantom = "phantom:lobster@24";
    let ways: [&[&str]; 7] = [
        &["render", phantom, "--method", "mc-quicksort", "--samples", "2^30", "-o", "a.png"],
        &["render", phantom, "--samples", "2^40", "--size", "10000x10000", "-o", "a.png"],
        &["render", phantom, "--samples", "2^40", "--size", "32768x32768", "-o", "a.npy"],
        &["project", "cloud.mcvr", "--size", "32768x32768", "-o", "a.npy"],
        &["sample", phantom, "--samples", "2^36", "-o", "a.mcvr"],
        &["orbit", "cloud.mcvr", "--size", "2000x2000", "--frames", "1000", "-o", "a.png"],
        &["converge", phantom, "--samples", "2^40", "--size", "10000x10000", "-o", "run"],
    ];
    for arguments in ways {
        let ended = finish(place.shell("ulimit -v 600000 || exit 77; exec \"$@\" --threads 2", arguments))?;
        if ended.code() == Some(77) {
            return Err(CaseError::Impossible("no limit to the address space here".into()));
        }
        let clear = ended.failed_with(1, &["bytes of memory", "free"]);
        tally.check(clear, || format!("{}: {}", arguments[0], ended.last_words()));
    }
    tally.check(place.names()? == ["cloud.mcvr"], || "something was written".into());
    Ok(tally.finding("checks", "7 commands in an address space of 600 MB"))
}
