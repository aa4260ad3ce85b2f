//! `wimu compare`.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;
use wimu_host::compare::{Alignment, Axis, Comparison, LinkReport, align, compare};
use wimu_host::mcap_file::RecordingReader;
use wimu_host::{ErrorCode, HostError, Input, Result};

use crate::arguments::Compare;
use crate::command::record::{clock_text, left_out_text};
use crate::output::Output;

#[derive(Serialize)]
struct Answer<'a, T> {
    schema: &'static str,
    status: &'static str,
    #[serde(flatten)]
    found: &'a T,
}

pub fn run(arguments: &Compare, output: Output) -> Result<()> {
    let kind = |input: &String| Input::parse(input);
    match (kind(&arguments.input)?, arguments.other.as_ref()) {
        (Input::Recording(path), None) => recording(&path, arguments, output),
        (Input::Csv(reference), Some(other)) => {
            let Input::Csv(other) = kind(other)? else {
                return Err(wrong(other));
            };
            if arguments.output.is_some()
                || arguments.report.is_some()
                || arguments.pictures.is_some()
            {
                return Err(HostError::new(
                    ErrorCode::Usage,
                    "-o, --report and --pictures are for a recording of two links",
                    "leave them out",
                ));
            }
            tables(&reference, &other, output)
        }
        _ => Err(wrong(&arguments.input)),
    }
}

fn wrong(input: &str) -> HostError {
    HostError::new(
        ErrorCode::Usage,
        "this cannot be compared so",
        "give one recording of both links, or two CSV files",
    )
    .at(input)
}

fn recording(path: &Path, arguments: &Compare, output: Output) -> Result<()> {
    let name = path.display().to_string();
    let found = compare(|| RecordingReader::open(path), &name)?;
    let text = text(&found);
    output.say(&text);
    if let Some(file) = &arguments.output {
        let model = found.values.as_ref().map(|values| &values.model);
        let model = model.ok_or_else(|| {
            HostError::new(
                ErrorCode::DataRefused,
                found.values_reason.clone().unwrap_or_default(),
                "record a longer motion",
            )
            .at(&name)
        })?;
        model.write(file)?;
        output.say(format!(
            "{}: the wireless link's error model; `wimu export --link wireless --link-model` takes it off",
            file.display()
        ));
    }
    if let Some(file) = &arguments.report {
        found.page(&text)?.write(file)?;
        output.say(format!("pictures: {}", file.display()));
    }
    if let Some(folder) = &arguments.pictures {
        let files = found.write_pictures(folder)?;
        output.say(format!("{}: {} pictures", folder.display(), files.len()));
    }
    output.object(&Answer {
        schema: "wimu.compare/1",
        status: "ok",
        found: &found,
    });
    Ok(())
}

/// What was found, in lines.
fn text(found: &Comparison) -> String {
    let mut text = format!(
        "{}: {:.1} s, {} {} samples on both links, {} of them identical{}",
        found.source,
        found.duration_s,
        found.pairs,
        found.stream,
        if found.identical == found.pairs {
            "all".to_owned()
        } else {
            found.identical.to_string()
        },
        match found.starts {
            1 => String::new(),
            starts => format!("; {starts} starts of the board"),
        }
    );
    if let Some(fault) = found.wholeness.fault() {
        let _ = write!(text, "\n  {fault}");
    }
    for link in &found.links {
        text += &link_text(link);
    }
    if let Some(clock) = &found.clock {
        let _ = write!(text, "\nboth     {}", clock_text(clock));
    }
    match (&found.values, &found.values_reason) {
        (Some(values), _) => {
            text += "\nvalues of wireless against cable:";
            text += &axes_text(&values.axes);
        }
        (None, Some(reason)) => {
            let _ = write!(text, "\nvalues: {reason}");
        }
        (None, None) => {}
    }
    if found.without_unit > 0 {
        let _ = write!(
            text,
            "\n  {} samples left out of the values: the range may have changed, and the epoch that tells is lost",
            found.without_unit
        );
    }
    text
}

fn link_text(link: &LinkReport) -> String {
    let mut text = format!(
        "\n{:8} {} delivered, {} lost, {} on neither link, {} duplicated, {} late; {} damaged frames, {} shed, {} interruptions{}",
        link.link,
        link.delivered,
        link.lost,
        link.missing_on_both,
        link.duplicated,
        link.late,
        link.damaged,
        link.shed
            .map_or("unknown".to_owned(), |shed| shed.to_string()),
        link.interruptions,
        left_out_text(link.unplaced, link.rejected)
    );
    if link.before + link.under_way > 0 {
        let _ = write!(
            text,
            "\n         of the other link's samples {} were taken before this one was heard, {} may have been under way at the end",
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
        let _ = write!(
            text,
            "\n         runs of missing samples: {}",
            runs.join(", ")
        );
    }
    let latency = &link.latency;
    let _ = write!(
        text,
        "\n         latency {:.1} ms median, {:.1} 95 %, {:.1} 99 %, {:.1} longest; jitter {:.1} ms; {:.1} samples/s, {:.0} bytes/s over the {:.1} s that it was open",
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
        let _ = write!(text, "\n         {}", clock_text(clock));
    }
    if let Some(user) = &link.by_arrival {
        let _ = write!(
            text,
            "\n         resampled by arrival instead of device time: {:.1} mm/s² rms wrong, {:.1} with the median latency taken off",
            user.rms_mps2 * 1e3,
            user.rms_without_latency_mps2 * 1e3
        );
    }
    text
}

fn axes_text(axes: &[Axis; 3]) -> String {
    let mut text = String::new();
    for (axis, name) in axes.iter().zip(["X", "Y", "Z"]) {
        let _ = match &axis.line {
            Some(line) => write!(
                text,
                "\n  {name}: bias {:+.4} ± {:.4} m/s², scale {:.5} ± {:.5}",
                line.bias_mps2,
                2.0 * line.bias_sd_mps2,
                line.scale,
                2.0 * line.scale_sd
            ),
            None => write!(
                text,
                "\n  {name}: offset {:+.4} ± {:.4} m/s² (too little motion for a scale)",
                axis.offset_mps2,
                2.0 * axis.offset_sd_mps2
            ),
        };
        let lsb = |lsb: Option<u32>| lsb.map_or(String::new(), |lsb| format!(" (most {lsb} LSB)"));
        let _ = write!(
            text,
            "; apart {:.2} mm/s² rms{}, under the model {:.2}{}",
            axis.rms_before_mps2 * 1e3,
            lsb(axis.max_before_lsb),
            axis.rms_after_mps2 * 1e3,
            lsb(axis.max_after_lsb)
        );
    }
    text
}

fn tables(reference: &Path, other: &Path, output: Output) -> Result<()> {
    let found: Alignment = align(reference, other)?;
    let mut text = format!(
        "{} against {}: {:.1} s in common at {:.1} Hz, magnitudes correlated by {:.3}\n\
         its time {:+.4} ± {:.4} s is the reference's{}",
        found.sources[1],
        found.sources[0],
        found.overlap_s,
        found.rate_hz,
        found.correlation,
        found.offset_s,
        2.0 * found.offset_sd_s,
        match (found.rate_ppm, found.rate_sd_ppm) {
            (Some(ppm), Some(sd)) => format!(
                "; its clock is {:.1} ± {:.1} ppm {}",
                ppm.abs(),
                2.0 * sd,
                if ppm > 0.0 { "slow" } else { "fast" }
            ),
            _ => String::new(),
        }
    );
    for (source, sd) in found.sources.iter().zip(found.unit_sd) {
        if let Some(sd) = sd {
            let _ = write!(
                text,
                "\n{source} is in LSB: its median magnitude is taken for 1 g, which may be off by {:.0} %, all scales alike",
                200.0 * sd
            );
        }
    }
    if found.saturated > 0 {
        let _ = write!(
            text,
            "\n{} moments at a sensor's end are left out",
            found.saturated
        );
    }
    match (&found.axes, &found.axes_reason) {
        (Some(axes), _) => {
            text += &match &found.turn {
                Some(turn) => format!(
                    "\nits axes are turned by {:.2} ± {:.2}° against the reference's; scales are along its own",
                    turn.angle_deg,
                    2.0 * turn.angle_sd_deg
                ),
                None => "\nthe motion does not show how its axes are turned against the reference's: turned by 5°, a \
                         scale may be 0.4 % low and a bias off by 9 % of what the others measure; move them through all orientations"
                    .to_owned(),
            };
            text += &axes_text(axes);
        }
        (None, Some(reason)) => {
            let _ = write!(text, "\nvalues: {reason}");
        }
        (None, None) => {}
    }
    output.say(&text);
    output.object(&Answer {
        schema: "wimu.compare_tables/1",
        status: "ok",
        found: &found,
    });
    Ok(())
}
