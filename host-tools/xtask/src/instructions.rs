//! What a sample costs in instructions: the image of `firmware/bench`, run in QEMU, which counts
//! them exactly.

use std::collections::BTreeMap;
use std::path::Path;

use wimu_testkit::figure;

use crate::command_line::{CommandLine, heading};
use crate::firmware;
use crate::setup::{self, Need, ThisMachine};

const FOLDER: &str = "firmware/bench";

/// The compiler whose code must be within the bars to the instruction. Another one, older or newer,
/// makes a few instructions more here and fewer there: it may be past a bar by this factor.
const COMPILER: &str = "1.95.0";
const OTHER_COMPILERS: f64 = 1.1;

/// A processor, and the machine of QEMU that has it.
struct Processor {
    name: &'static str,
    target: &'static str,
    machine: &'static str,
}

/// QEMU has no Cortex-M0+; Cortex-M0 runs the same instructions.
const PROCESSORS: [Processor; 2] = [
    Processor { name: "Cortex-M4F", target: "thumbv7em-none-eabihf", machine: "mps2-an386" },
    Processor { name: "Cortex-M0+", target: "thumbv6m-none-eabi", machine: "microbit" },
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

const ROWS: [Row; 20] = [
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
];

/// x-io Fusion, 6 axes, per sample, as published: an attitude filter in f32.
const FUSION: [f64; 2] = [199.0, 10_328.0];

/// Instructions per sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cost {
    mean: f64,
    most: f64,
}

type Costs = BTreeMap<String, Cost>;

/// Builds the image for every processor, runs it, and prints the table.
///
/// # Errors
/// Says what is missing, which command failed, or which costs are past their bars.
pub fn run() -> Result<(), String> {
    setup::provide(Need::Qemu, &mut ThisMachine)?;
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let folder = Path::new(FOLDER);
    let mut costs = Vec::new();
    for processor in &PROCESSORS {
        let output = firmware::built(source, folder, Some(processor.target))?;
        let image = output.image("bench", processor.target);
        let run = CommandLine::new("qemu-system-arm -display none -monitor none -serial none")
            .words("-icount shift=10 -semihosting-config enable=on,target=native")
            .words(&format!("-M {} -kernel", processor.machine))
            .word(&image.display().to_string());
        println!("$ {run}");
        let text = run.output().ok_or_else(|| format!("`{run}` failed: run it to see why"))?;
        costs.push(parsed(&text)?);
    }
    record(&costs);
    heading("instructions per sample: mean (most)");
    print!("{}{}", table(&costs), fits(&costs)?);
    judged(&costs, &setup::embedded_release(source)?)
}

/// Records the costs that have a bar.
fn record(costs: &[Costs]) {
    for row in &ROWS {
        for (index, (costs, processor)) in costs.iter().zip(&PROCESSORS).enumerate() {
            let bar = row.bars.map_or(f64::INFINITY, |bars| bars[index]);
            if let (Some(cost), true) = (costs.get(row.key), bar.is_finite()) {
                let claim = format!("instructions, {}, {}", processor.name, row.about);
                let measured = format!("{:.0} on average", cost.mean);
                figure(&claim, measured, &format!("at most {bar:.0}"), cost.mean <= bar);
            }
        }
    }
}

/// Whether the costs are within their bars, for code made by the compiler of this release.
fn judged(costs: &[Costs], release: &str) -> Result<(), String> {
    let past_the_bars = exceeded(costs, 1.0);
    if past_the_bars.is_empty() {
        return Ok(());
    }
    if release == COMPILER {
        return Err(past_the_bars.join("\n"));
    }
    let how = format!(
        "the bars hold for rustc {COMPILER}, this is {release}; to count with that one:\n    \
         rustup toolchain install {COMPILER} --target {} && cargo +{COMPILER} xtask budget",
        PROCESSORS.map(|processor| processor.target).join(",")
    );
    let far_past = exceeded(costs, OTHER_COMPILERS);
    if far_past.is_empty() {
        println!("{}\n{how}", past_the_bars.join("\n"));
        Ok(())
    } else {
        Err(format!("{}\n{how}", far_past.join("\n")))
    }
}

/// What a calibration costs on the Cortex-M4F, once.
fn fits(costs: &[Costs]) -> Result<String, String> {
    let cost = |key| {
        let cost = costs.first().and_then(|costs| costs.get(key));
        cost.map(|cost| cost.mean)
            .ok_or_else(|| format!("{key} on {}: was not measured", PROCESSORS[0].name))
    };
    Ok(format!(
        "a nine-parameter fit of 38 poses with covariance and leave-one-out, {}: {:.0} \
         instructions in f64 (software), {:.0} in f32\n",
        PROCESSORS[0].name,
        cost("fit")?,
        cost("fit-f32")?
    ))
}

/// Lines of a name, the mean and the most.
fn parsed(text: &str) -> Result<Costs, String> {
    text.lines()
        .map(|line| {
            let mut words = line.split_whitespace();
            let name = words.next()?;
            let mean = words.next()?.parse().ok()?;
            let most = words.next()?.parse().ok()?;
            Some((name.to_owned(), Cost { mean, most }))
        })
        .collect::<Option<Costs>>()
        .filter(|costs| !costs.is_empty())
        .ok_or_else(|| format!("the image printed something else than counts:\n{text}"))
}

fn table(costs: &[Costs]) -> String {
    let cell = |cost: Option<&Cost>| {
        cost.map_or(String::new(), |cost| format!("{:.0} ({:.0})", cost.mean, cost.most))
    };
    let mut text = format!("{:<46}", "");
    for processor in &PROCESSORS {
        text += &format!("{:>14}{:>12}{:>6}", processor.name, "f32", "bar");
    }
    text.push('\n');
    for row in &ROWS {
        text += &format!("{:<46}", row.about);
        for (index, costs) in costs.iter().enumerate() {
            let bar = row
                .bars
                .filter(|bars| bars[index].is_finite())
                .map_or(String::new(), |bars| format!("{:.0}", bars[index]));
            let float = costs.get(&format!("{}-f32", row.key));
            let float = float.map_or(String::new(), |cost| format!("{:.0}", cost.mean));
            text += &format!("{:>14}{float:>12}{bar:>6}", cell(costs.get(row.key)));
        }
        text.push('\n');
    }
    text += &format!("{:<46}", "x-io Fusion, 6 axes, as published");
    for published in FUSION {
        text += &format!("{:>14}{published:>12.0}{:>6}", "", "");
    }
    text.push('\n');
    text
}

/// What costs more than `slack` times what it may, or was not measured.
fn exceeded(costs: &[Costs], slack: f64) -> Vec<String> {
    let mut problems = Vec::new();
    for row in &ROWS {
        for (index, (costs, processor)) in costs.iter().zip(&PROCESSORS).enumerate() {
            let what = format!("{} on {}", row.about, processor.name);
            match (costs.get(row.key), row.bars) {
                // No bar at all: not for this processor.
                (None, Some(bars)) if !bars[index].is_finite() => {}
                (None, _) => problems.push(format!("{what}: was not measured")),
                (Some(cost), Some(bars)) if cost.mean > slack * bars[index] => problems.push(
                    format!("{what}: {:.1} instructions, the bar is {:.0}", cost.mean, bars[index]),
                ),
                _ => {}
            }
        }
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every row at `cost`.
    fn everywhere(cost: f64) -> Costs {
        ROWS.iter()
            .map(|row| {
                let cost = Cost { mean: cost, most: cost };
                (row.key.to_owned(), cost)
            })
            .collect()
    }

    #[test]
    fn what_the_image_prints_is_understood() {
        let costs = parsed("correction 39.0 40\ngap 5.5 6\n").unwrap();
        let cost = Cost { mean: 5.5, most: 6.0 };
        assert_eq!(costs["gap"], cost);
        assert_eq!(costs.len(), 2);
        assert!(parsed("").is_err());
        assert!(parsed("error: out of order").unwrap_err().contains("out of order"));
    }

    #[test]
    fn a_cost_past_its_bar_is_named_and_one_at_it_is_not() {
        assert_eq!(judged(&[everywhere(92.0), everywhere(170.0)], COMPILER), Ok(()));
        assert_eq!(
            judged(&[everywhere(92.1), everywhere(170.0)], COMPILER),
            Err(
                "correction and integration, inlined together on Cortex-M4F: 92.1 instructions, the bar is 92"
                    .into()
            )
        );
    }

    #[test]
    fn code_of_another_compiler_may_cost_a_tenth_more_and_no_more() {
        assert_eq!(judged(&[everywhere(101.0), everywhere(170.0)], "1.99.0"), Ok(()));
        let problem = judged(&[everywhere(101.3), everywhere(170.0)], "1.99.0").unwrap_err();
        let how = format!("cargo +{COMPILER} xtask budget");
        assert!(problem.contains("101.3") && problem.contains(&how), "{problem}");
    }

    #[test]
    fn a_cost_that_is_missing_is_named() {
        let mut costs = everywhere(1.0);
        costs.remove("gap");
        let problems = exceeded(&[costs, everywhere(1.0)], 1.0);
        assert_eq!(problems, ["a gap, when there is one on Cortex-M4F: was not measured"]);
    }

    #[test]
    fn the_table_has_a_line_for_each_row() {
        let text = table(&[everywhere(1.0), everywhere(2.0)]);
        assert_eq!(text.lines().count(), 1 + ROWS.len() + 1);
        assert!(text.contains("Cortex-M0+") && text.contains("10328"));
    }
}
