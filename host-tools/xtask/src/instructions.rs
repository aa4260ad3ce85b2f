//! What a sample costs in instructions: the image of `firmware/bench`, run in QEMU, which counts
//! them exactly.

use std::collections::BTreeMap;

use wimu_testkit::figure;
use xshell::Shell;

use crate::boards::BENCH;
use crate::budget::qemu;
use crate::setup::TARGETS;
use crate::{Result, heading};

/// A compiler makes a few instructions more here and fewer there than Rust 1.95, for which the bars are: past a bar by
/// this factor is a failure.
const OTHER_COMPILERS: f64 = 1.1;

/// A processor, and the machine of QEMU that has it.
struct Processor {
    name: &'static str,
    target: &'static str,
    machine: &'static str,
}

/// QEMU has no Cortex-M0+; Cortex-M0 runs the same instructions.
const PROCESSORS: [Processor; 2] = [
    Processor { name: "Cortex-M4F", target: TARGETS[0], machine: "mps2-an386" },
    Processor { name: "Cortex-M0+", target: TARGETS[1], machine: "microbit" },
];

/// A line of the table.
struct Row {
    /// As the image names it.
    key: &'static str,
    about: &'static str,
    /// The most that a sample may cost, on each processor.
    bars: Option<[f64; 2]>,
}

const fn row(key: &'static str, about: &'static str) -> Row {
    Row { key, about, bars: None }
}

const fn barred(key: &'static str, about: &'static str, bars: [f64; 2]) -> Row {
    Row { key, about, bars: Some(bars) }
}

const ROWS: [Row; 21] = [
    row("correction", "correction"),
    row("integration", "integration"),
    barred("correction+integration", "correction and integration, inlined together", [92.0, 170.0]),
    row("saturation", "check for saturation"),
    row("integrator-step", "integrator in whole: with stillness and gaps"),
    row("gap", "a gap, when there is one"),
    row("six-correction", "six axes: correction with g-sensitivity"),
    row("six-attitude", "six axes: attitude"),
    barred("six-correction+attitude", "six axes: correction and attitude", [400.0, 1500.0]),
    row("six-complete", "six axes: complete, with position"),
    barred("packing-rest", "packing 16 samples at rest, 12 bits", [150.0, 400.0]),
    row("framing-rest", "their frame: CRC and COBS"),
    barred("packing-motion", "packing 16 samples in motion, 16 bits", [150.0, 400.0]),
    row("framing-motion", "their frame: CRC and COBS"),
    row("batch-rest", "packing and frame, at rest"),
    row("batch-motion", "packing and frame, in motion"),
    row("path-rest", "counts to frames of raw samples, at rest"),
    row("path-motion", "counts to frames of raw samples, in motion"),
    row("array-four", "four triads to ω, ω̇ and s in f32, all roots"),
    barred("array-eight", "eight triads, the same", [15_000.0, f64::INFINITY]),
    // Once, with covariance and leave-one-out; in f64 by software.
    Row { bars: Some([f64::INFINITY; 2]), ..row("fit", "a nine-parameter fit of 38 poses") },
];

/// For comparison.
const FUSION: &str =
    "x-io Fusion, 6 axes, f32, as published: 199 on Cortex-M4F, 10328 on Cortex-M0+";

/// Instructions per sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cost {
    mean: f64,
    most: f64,
}

type Costs = BTreeMap<String, Cost>;

/// Builds the image for every processor, runs it, and prints a table for each.
pub fn run(sh: &Shell) -> Result {
    let mut problems = Vec::new();
    for (index, Processor { name, target, machine }) in PROCESSORS.iter().enumerate() {
        BENCH.build(sh, &["--target", target])?;
        let image = BENCH.image_for("bench", target);
        let costs = parsed(&qemu(sh, machine, &["-icount", "shift=10"], &image)?)?;
        heading(&format!("instructions per sample on {name}"));
        print!("{}", table(&costs));
        println!("{FUSION}");
        problems.extend(exceeded(name, index, &costs));
    }
    if problems.is_empty() { Ok(()) } else { Err(problems.join("\n").into()) }
}

/// Lines of a name, the mean and the most.
fn parsed(text: &str) -> Result<Costs> {
    let cost = |line: &str| {
        let mut words = line.split_whitespace();
        let name = words.next()?.to_owned();
        Some((name, Cost { mean: words.next()?.parse().ok()?, most: words.next()?.parse().ok()? }))
    };
    let costs: Option<Costs> = text.lines().map(cost).collect();
    let costs = costs.filter(|costs| !costs.is_empty());
    costs.ok_or_else(|| format!("the image printed something else than counts:\n{text}").into())
}

/// The mean and the most of each row, the mean in f32 where there is one.
fn table(costs: &Costs) -> String {
    let mut text = format!("{:<46}{:>9}{:>9}{:>9}\n", "", "mean", "most", "f32");
    for row in &ROWS {
        let Some(cost) = costs.get(row.key) else { continue };
        let float = costs.get(&format!("{}-f32", row.key));
        let float = float.map_or(String::new(), |cost| format!("{:.0}", cost.mean));
        text += &format!("{:<46}{:>9.0}{:>9.0}{float:>9}\n", row.about, cost.mean, cost.most);
    }
    text
}

/// Records the costs that have a bar on a processor, and says which are far past it or were not measured.
fn exceeded(processor: &str, index: usize, costs: &Costs) -> Vec<String> {
    let mut problems = Vec::new();
    for row in &ROWS {
        let what = format!("{processor}, {}", row.about);
        let bar = row.bars.map_or(f64::INFINITY, |bars| bars[index]);
        let Some(cost) = costs.get(row.key) else {
            // A row with a bar on the other processor alone is not measured on this one.
            if row.bars.is_none() || bar.is_finite() {
                problems.push(format!("{what}: was not measured"));
            }
            continue;
        };
        if bar.is_finite() {
            let measured = format!("{:.0} on average", cost.mean);
            let target = format!("at most {bar:.0}");
            figure(&format!("instructions, {what}"), measured, &target, cost.mean <= bar);
        }
        if cost.mean > OTHER_COMPILERS * bar {
            problems.push(format!("{what}: {:.1} instructions, the bar is {bar:.0}", cost.mean));
        }
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    fn everywhere(mean: f64) -> Costs {
        ROWS.iter().map(|row| (row.key.to_owned(), Cost { mean, most: mean })).collect()
    }

    #[test]
    fn what_the_image_prints_is_understood() {
        let costs = parsed("correction 39.0 40\ngap 5.5 6\n").unwrap();
        assert_eq!(costs["gap"], Cost { mean: 5.5, most: 6.0 });
        assert_eq!(costs.len(), 2);
        assert!(parsed("").is_err());
        assert!(parsed("error: out of order").unwrap_err().to_string().contains("out of order"));
    }

    #[test]
    fn a_cost_far_past_its_bar_or_missing_is_named() {
        assert!(exceeded("M4F", 0, &everywhere(101.0)).is_empty());
        let mut costs = everywhere(101.3);
        costs.remove("gap");
        let problems = exceeded("M4F", 0, &costs);
        assert_eq!(problems.len(), 2, "{problems:?}");
        assert!(problems[0].contains("101.3") && problems[1].contains("was not measured"));
    }
}
