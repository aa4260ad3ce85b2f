//! `wimu compare`.

use std::path::Path;

use wimu_host::compare::{Alignment, Axis, Comparison, LinkReport, align, compare};
use wimu_host::digits::{signed_with_sd, with_sd};
use wimu_host::mcap_file::RecordingReader;
use wimu_host::{Code, Input, Problem, Result};

use crate::arguments::Compare;
use crate::command::record::{clock_text, left_out_text};
use crate::output::{Output, usage};

pub fn run(arguments: &Compare, output: &Output) -> Result<()> {
    let kind = |input: &String| Input::parse(input);
    match (kind(&arguments.input)?, arguments.other.as_ref()) {
        (Input::Recording(path), None) => recording(&path, arguments, output),
        (Input::File(reference), Some(other)) => {
            let Input::File(other) = kind(other)? else {
                return Err(unsupported(other));
            };
            tables(&reference, &other, output)
        }
        _ => Err(unsupported(&arguments.input)),
    }
}

fn unsupported(input: &str) -> Problem {
    usage("this input cannot be compared", "give one recording of both links, or two CSV files")
        .at(input)
}

fn recording(path: &Path, arguments: &Compare, output: &Output) -> Result<()> {
    let name = wimu_host::untrusted::name(path);
    let found = compare(|| RecordingReader::open(path), &name)?;
    let text = text(&found);
    output.print(&text);
    output.findings(&found.findings);
    if let Some(file) = &arguments.output {
        let model = found.values.as_ref().map(|values| &values.model);
        let model = model.ok_or_else(|| {
            Code::DataRefused
                .error(found.values_reason.clone().unwrap_or_default(), "record a longer motion")
                .at(&name)
        })?;
        model.write(file)?;
        output.print(format!(
            "wrote {}: the wireless link's error model, for `wimu convert --topic wireless --with`",
            file.display()
        ));
    }
    if let Some(file) = &arguments.report {
        found.page(&text).write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    output.object(&found);
    Ok(())
}

/// The comparison as text.
fn text(found: &Comparison) -> String {
    let mut text = format!(
        "{}: {:.1} s, {} {} samples on both links, {} of them identical{}{}",
        found.source,
        found.duration_s,
        found.pairs,
        found.stream,
        if found.identical == found.pairs { "all".to_owned() } else { found.identical.to_string() },
        match (found.with_rates, found.rates_differ) {
            (0, 0) => String::new(),
            (with, 0) => format!(", {with} with equal angular rates"),
            (with, differ) => format!(", {differ} of {with} angular rates differ"),
        },
        match found.starts {
            1 => String::new(),
            starts => format!("; {starts} starts of the board"),
        }
    );
    for link in &found.links {
        text += &link_text(link);
    }
    if let Some(clock) = &found.clock {
        text += &format!("\nboth     {}", clock_text(clock));
    }
    if let Some(values) = &found.values {
        text += "\nvalues of wireless against cable (± is 1 σ):";
        text += &axes_text(&values.axes);
    }
    text
}

fn link_text(link: &LinkReport) -> String {
    let mut text = format!(
        "\n{:8} {} delivered, {} lost, {} lost on both links, {} duplicated, {} delayed; {} damaged frames, dropped by the board: {}, {} interruptions{}",
        link.link,
        link.delivered,
        link.lost,
        link.missing_on_both,
        link.duplicated,
        link.late,
        link.damaged,
        link.shed.map_or("unknown".to_owned(), |shed| shed.to_string()),
        link.interruptions,
        left_out_text(link.unplaced, link.rejected)
    );
    if link.before + link.under_way > 0 {
        text += &format!(
            "\n         of the other link's samples, {} precede the first on this link, {} may have been in transit at the end",
            link.before, link.under_way
        );
    }
    if !link.bursts.is_empty() {
        let runs: Vec<String> = link
            .bursts
            .iter()
            .map(|burst| match burst.to - burst.from {
                0 => format!("{} × {}", burst.runs, burst.from),
                _ => format!("{} × {}-{}", burst.runs, burst.from, burst.to),
            })
            .collect();
        text += &format!("\n         runs of missing samples: {}", runs.join(", "));
    }
    let latency = &link.latency;
    text += &format!(
        "\n         latency {:.1} ms median, {:.1} ms (95 %), {:.1} ms (99 %), {:.1} ms at most; jitter {:.1} ms; {:.1} samples/s, {:.0} bytes/s in the {:.1} s that it was open",
        latency.median_ms,
        latency.p95_ms,
        latency.p99_ms,
        latency.max_ms,
        link.jitter_ms,
        link.samples_per_s,
        link.bytes_per_s,
        link.open_s
    );
    if let Some(clock) = &link.clock {
        text += &format!("\n         {}", clock_text(clock));
    }
    if let Some(user) = &link.by_arrival {
        text += &format!(
            "\n         error if resampled by arrival time: {:.1} mm/s² rms, {:.1} mm/s² after subtracting the median latency",
            user.rms_mps2 * 1e3,
            user.rms_without_latency_mps2 * 1e3
        );
    }
    text
}

fn axes_text(axes: &[Axis; 3]) -> String {
    let mut text = String::new();
    for (axis, name) in axes.iter().zip(["X", "Y", "Z"]) {
        text += &match &axis.line {
            Some(line) => format!(
                "\n  {name}: bias {} m/s², scale factor {}",
                signed_with_sd(line.bias_mps2, line.bias_sd_mps2),
                with_sd(line.scale, line.scale_sd)
            ),
            None => format!(
                "\n  {name}: offset {} m/s² (too little motion for a scale factor)",
                signed_with_sd(axis.offset_mps2, axis.offset_sd_mps2)
            ),
        };
        text += &format!(
            "; difference {:.2} mm/s² rms{}, residual {:.2} mm/s² rms",
            axis.rms_before_mps2 * 1e3,
            axis.max_before_lsb.map_or(String::new(), |lsb| format!(" (at most {lsb} LSB)")),
            axis.rms_after_mps2 * 1e3
        );
    }
    text
}

fn tables(reference: &Path, other: &Path, output: &Output) -> Result<()> {
    let found: Alignment = align(reference, other)?;
    let mut text = format!(
        "{} against {}: {:.1} s in common at {:.1} Hz, correlation of the magnitudes {:.3}\n\
         clock offset {} s{}; ± is 1 σ",
        found.sources[1],
        found.sources[0],
        found.overlap_s,
        found.rate_hz,
        found.correlation,
        signed_with_sd(found.offset_s, found.offset_sd_s),
        match (found.rate_ppm, found.rate_sd_ppm) {
            (Some(ppm), Some(sd)) => format!(
                ", {} ppm {}",
                with_sd(ppm.abs(), sd),
                if ppm > 0.0 { "slow" } else { "fast" }
            ),
            _ => String::new(),
        }
    );
    if let Some(turn) = &found.turn {
        text += &format!(
            "\nits axes are rotated by {}° (1 σ) from the reference's; scale factors are along its own axes",
            with_sd(turn.angle_deg, turn.angle_sd_deg)
        );
    }
    text += &found.axes.as_ref().map(axes_text).unwrap_or_default();
    output.print(&text);
    output.findings(&found.findings);
    output.object(&found);
    Ok(())
}
