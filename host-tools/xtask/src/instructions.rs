//! What a sample costs in instructions: the image of `firmware/bench`, run in QEMU, which counts
//! them exactly.

use wimu_testkit::figure;
use xshell::Shell;

use crate::boards::{BENCH, Board};
use crate::budget::qemu;
use crate::setup::TARGETS;
use crate::{Result, heading};

/// A compiler makes a few instructions more here and fewer there than Rust 1.95, for which the bars are: past a bar by
/// this factor is a failure.
const OTHER_COMPILERS: f64 = 1.1;

/// Processors, the image for each, and the machines of QEMU that have them. QEMU has no Cortex-M0+; Cortex-M0 runs the
/// same instructions.
const PROCESSORS: [(&str, Board, &str); 2] = [
    ("Cortex-M4F", BENCH, "mps2-an386"),
    ("Cortex-M0+", Board { target: TARGETS[1], ..BENCH }, "microbit"),
];

/// Counts that have a bar: the name that the image prints, what it is, and the most instructions per sample on each
/// processor.
const BARS: [(&str, &str, [f64; 2]); 4] = [
    ("correction+integration", "correction and integration, inlined together", [92.0, 170.0]),
    ("six-correction+attitude", "six axes: correction and attitude", [400.0, 1500.0]),
    ("packing-rest", "packing 16 samples at rest, 12 bits", [150.0, 400.0]),
    ("packing-motion", "packing 16 samples in motion, 16 bits", [150.0, 400.0]),
];

/// Builds the image for every processor, runs it and prints its counts.
pub fn run(sh: &Shell) -> Result {
    let mut problems = Vec::new();
    for (index, (processor, board, machine)) in PROCESSORS.into_iter().enumerate() {
        board.build(sh, &["--target", board.target])?;
        let image = board.image(board.program);
        let counts = qemu(sh, machine, &["-icount", "shift=10"], &image)?;
        heading(&format!("instructions per sample on {processor}: mean and most"));
        println!("{counts}");
        for (name, about, bars) in BARS {
            let bar = bars[index];
            let mean = mean(&counts, name).ok_or_else(|| format!("{name} was not measured"))?;
            let measured = format!("{mean:.0} on average");
            let claim = format!("instructions, {processor}, {about}");
            figure(&claim, measured, &format!("at most {bar:.0}"), mean <= bar);
            if mean > OTHER_COMPILERS * bar {
                problems.push(format!("{processor}, {about}: {mean:.1}, the bar is {bar:.0}"));
            }
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(problems.join("\n").into()) }
}

/// The mean in the line `name mean most` of what the image prints.
fn mean(counts: &str, name: &str) -> Option<f64> {
    let mut lines = counts.lines().map(str::split_whitespace);
    lines.find_map(|mut words| (words.next()? == name).then(|| words.next()?.parse().ok())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_is_that_of_the_line_with_the_whole_name() {
        let counts = "gap-f32 7.0 8\ngap 5.5 6\nerror: out of order";
        assert_eq!(mean(counts, "gap"), Some(5.5));
        assert_eq!(mean(counts, "error:"), None);
    }
}
