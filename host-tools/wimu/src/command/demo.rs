//! `wimu demo`: record, calibrate and navigate with a simulated board.

mod walks;

use std::time::Instant;

use serde_json::json;
use wimu_host::chart::{self, Chart, Series};
use wimu_host::compare::{Comparison, compare};
use wimu_host::digits::significant;
use wimu_host::document::Document;
use wimu_host::mcap_file::RecordingReader;
use wimu_host::navigation::{Point, distance_m};
use wimu_host::{Code, OutputFile, Result};
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::scenario::{Calibration, FirstLight, Outcome};

use crate::arguments::Demo;
use crate::output::Output;

/// The wireless link: a serial Bluetooth adapter that loses some of its bytes.
const WIRELESS: &str = "bluetooth,loss=0.3%,bits=1e-5";

pub fn run(arguments: &Demo, output: &Output) -> Result<()> {
    if let Some(folder) = &arguments.localize {
        return walks::run(arguments.seed, folder, output);
    }
    let began = Instant::now();
    let sensor = arguments.chip.into();
    let outcome =
        FirstLight { seed: arguments.seed, sensor, calibration: Calibration::TwelvePoses }.run_on(
            |source| {
                let config = BoardConfig {
                    wireless_faults: WIRELESS.parse().map_err(|error| {
                        Code::VerifyFailed.error(
                            format!("the demo's link: {error}"),
                            "report this as a fault of wimu",
                        )
                    })?,
                    fault_seed: arguments.seed,
                    sensor,
                    ..BoardConfig::default()
                };
                Ok(Board::start(config, source))
            },
        )?;
    let links = compare(
        || RecordingReader::new(outcome.recording.as_slice(), "the recording"),
        "the recording",
    )?;
    let story = story(&outcome, &links, arguments.seed);
    for line in &story {
        output.print(line);
    }
    let recording = arguments.report.with_extension("mcap");
    OutputFile::write(&recording, &outcome.recording)?;
    let charts = charts(&outcome);
    let mut page = report(&outcome, &charts, &story);
    for chart in &links.charts() {
        page.chart(chart);
    }
    page.write(&arguments.report)?;
    if let Some(folder) = &arguments.pictures {
        chart::write_all(folder, &charts)?;
    }
    output.print(format!(
        "{:.0} s of board time in {:.1} s. Pictures: {}; recording: {} (try `{}` on it).",
        outcome.duration_s,
        began.elapsed().as_secs_f64(),
        arguments.report.display(),
        recording.display(),
        match outcome.attitude_deg {
            Some(_) => "wimu convert --stream navigation -o positions.csv",
            None => "wimu navigate",
        }
    ));
    let [before, after] = outcome.tilts_rms_mps2();
    let exact = outcome.replays.iter().all(|replay| replay.is_exact());
    let replayed: u64 = outcome.replays.iter().map(|replay| replay.corrected_compared).sum();
    // Of `attitude_deg` and the slides the first is uncalibrated, the last with zero-velocity updates.
    output.object(&json!({
        "seed": arguments.seed,
        "tilts_before_mm_s2": before * 1e3,
        "tilts_after_mm_s2": after * 1e3,
        "slide_uncalibrated_m": outcome.slide.uncalibrated_m,
        "slide_calibrated_m": outcome.slide.calibrated_m,
        "slide_zupt_m": outcome.slide.zupt_m,
        "attitude_deg": outcome.attitude_deg,
        "samples_replayed": replayed,
        "replay_exact": exact,
        "parameter_id": outcome.after_restart.to_string(),
        "report": arguments.report.display().to_string(),
        "recording": recording.display().to_string(),
    }));
    let locked = outcome.refusals.iter().all(Option::is_some);
    if exact && locked && outcome.pushed == outcome.after_restart {
        Ok(())
    } else {
        Err(Code::VerifyFailed.error(
            "the device's results or stored parameters differ from the expected ones",
            "report this as a fault of wimu, with the seed",
        ))
    }
}

/// The steps, one line each.
fn story(outcome: &Outcome, links: &Comparison, seed: u64) -> Vec<String> {
    let hidden = outcome.truth.model.terms();
    let mg = |bias: f64| bias * 1e3 / wimu_model::STANDARD_GRAVITY_MPS2;
    let [bx, by, bz] = hidden.bias_mps2.map(mg);
    let scale = [0, 1, 2].map(|axis| (hidden.matrix[axis][axis] - 1.0) * 100.0);
    let [before, after] = outcome.tilts_rms_mps2().map(|rms| rms * 1e3);
    let slide = &outcome.slide;
    let replayed: u64 = outcome.replays.iter().map(|r| r.corrected_compared).sum();
    let estimate = outcome.report.estimate.as_ref();
    let worst_bias_mg = estimate.map_or(0.0, |estimate| {
        let found = estimate.model.terms().bias_mps2;
        (0..3)
            .map(|axis| mg(found[axis]) - mg(hidden.bias_mps2[axis]))
            .fold(0.0_f64, |worst, error| worst.max(error.abs()))
    });
    let six = SixAxes::of(outcome);
    let mut lines = vec![
        format!(
            "A simulated board ({}, seed {seed}). Its accelerometer has errors that wimu does not know:",
            outcome.hello.sensor.name
        ),
        format!(
            "  bias {bx:+.0} {by:+.0} {bz:+.0} mg, scale {:+.1} {:+.1} {:+.1} %, misaligned axes, noise as in the datasheet.",
            scale[0], scale[1], scale[2]
        ),
    ];
    lines.extend(six.hidden);
    lines.extend([
        format!(
            "1 stream     raw samples, corrected samples{} and position, over a cable and a wireless link that loses bytes",
            six.and_attitude
        ),
        format!(
            "2 move       {}, uncalibrated: position error {:.2} m{} after 3 s",
            six.path, slide.uncalibrated_m, six.errors[0]
        ),
        format!(
            "3 record     {} samples while the board is held in {} poses{}",
            outcome.samples, outcome.report.poses.len(), six.rotations
        ),
        format!(
            "4 calibrate  9 parameters from gravity alone (bias, scale, 3 misalignments); bias error {worst_bias_mg:.2} mg{}",
            six.calibrated
        ),
        format!(
            "5 push       over the wireless link: {}; signed with the board's key: accepted in {:.0} ms",
            if outcome.refusals.iter().all(Option::is_some) {
                "refused without the key"
            } else {
                "accepted without the key"
            },
            outcome.push_s * 1e3
        ),
        format!(
            "6 restart    the board still holds parameters {}",
            outcome.after_restart
        ),
        format!(
            "7 verify     |f| − g on ten new tilts: {before:.1} mm/s² before, {after:.2} mm/s² after: {:.0} times less",
            before / after
        ),
        format!(
            "8 navigate   the same {}: position error {:.1} mm{}; with zero-velocity updates {:.1} mm{}",
            six.again,
            slide.calibrated_m * 1e3,
            six.errors[1],
            slide.zupt_m * 1e3,
            six.errors[2]
        ),
        format!(
            "9 replay     {replayed} corrected samples and all positions{} recomputed on the host: {}",
            six.and_attitudes,
            if outcome.replays.iter().all(|replay| replay.is_exact()) {
                "bit for bit equal"
            } else {
                "DIFFERENT"
            }
        ),
        format!(
            "10 compare   {} samples over both links, {} equal; wireless: {} lost and counted; latency {:.0} ms, at most {:.0} ms",
            links.pairs,
            if links.identical == links.pairs {
                "all"
            } else {
                "NOT all"
            },
            links.links[1].lost,
            links.links[1].latency.median_ms,
            links.links[1].latency.max_ms
        ),
    ]);
    lines
}

/// The parts of the story that a gyroscope changes.
#[derive(Default)]
struct SixAxes {
    hidden: Option<String>,
    and_attitude: &'static str,
    and_attitudes: &'static str,
    path: &'static str,
    again: &'static str,
    rotations: &'static str,
    calibrated: String,
    errors: [String; 3],
}

impl SixAxes {
    fn of(outcome: &Outcome) -> Self {
        let Some(errors_deg) = outcome.attitude_deg else {
            return Self { path: "a 1 m slide", again: "slide", ..Self::default() };
        };
        let hidden = outcome.truth.gyroscope.model.terms();
        let [bx, by, bz] = hidden.bias_rad_s.map(f64::to_degrees);
        let scale = [0, 1, 2].map(|axis| (hidden.matrix[axis][axis] - 1.0) * 100.0);
        let found = outcome.parameters.gyroscope.map(|found| found.model);
        let matrix = found.map_or(hidden.matrix, |model| model.terms().matrix);
        let errors = matrix.as_flattened().iter().zip(hidden.matrix.as_flattened());
        let worst = errors.fold(0.0_f64, |worst, (found, truth)| worst.max((found - truth).abs()));
        Self {
            hidden: Some(format!(
                "  gyroscope: bias {bx:+.1} {by:+.1} {bz:+.1} °/s, scale {:+.1} {:+.1} {:+.1} %, misaligned axes, g-sensitivity, noise.",
                scale[0], scale[1], scale[2]
            )),
            and_attitude: ", attitude",
            and_attitudes: " and attitudes",
            path: "1 m while the board rotates by 90°",
            again: "path",
            rotations: " and rotated by 360° about each axis",
            calibrated: format!(
                "; gyroscope: scale and misalignment from the rotations, largest error {:.2} %",
                worst * 100.0
            ),
            errors: errors_deg.map(|error| format!(", attitude error {error:.2}°")),
        }
    }
}

/// The demo's own pictures, with their file names.
fn charts(outcome: &Outcome) -> [(&'static str, Chart); 2] {
    let tilt = |which: usize, name: &str| {
        let tilts = outcome.tilts.iter().enumerate();
        let points = tilts.map(|(index, tilt)| (index as f64 + 1.0, tilt[which].abs() * 1e3));
        Series::dots(name, points.collect())
    };
    let title = "|f| − g on ten tilts that were not used in the fit";
    let series = vec![tilt(0, "uncorrected"), tilt(1, "corrected on the board")];
    let tilts = Chart {
        log: true,
        y_range: Some((0.01, 2000.0)),
        ..Chart::new(title, "tilt", "mm/s²", series)
    };
    let path = |points: &[Point], name: &str| {
        let start = points.first().map_or(0.0, |point| point.time.to_seconds());
        let from = points.first().map_or([0.0; 3], |point| point.navigation.position.to_m());
        let distance = |point: &Point| {
            let to = point.navigation.position.to_m();
            (point.time.to_seconds() - start, distance_m(from, to))
        };
        Series::line(name, points.iter().map(distance).collect())
    };
    let what = match outcome.attitude_deg {
        Some(_) => "path",
        None => "slide",
    };
    let title =
        format!("Distance computed by the board, for a {what} of 1 m in 3 s between two rests");
    let series = vec![
        path(&outcome.uncalibrated_path, "uncalibrated"),
        path(&outcome.calibrated_path, "calibrated"),
        path(&outcome.zupt_path, "calibrated, zero-velocity updates"),
    ];
    let slide = Chart {
        y_range: Some((0.0, 3.0)),
        ..Chart::new(title, "time (s)", "distance from the start (m)", series)
    };
    [("tilts", tilts), ("slide", slide)]
}

fn report(outcome: &Outcome, charts: &[(&str, Chart)], story: &[String]) -> Document {
    let mut report = Document::new("wimu demo");
    let exact = outcome.replays.iter().all(|replay| replay.is_exact());
    let [before, after] = outcome.tilts_rms_mps2().map(|rms| significant(rms * 1e3, 3));
    let slide =
        [outcome.slide.uncalibrated_m, outcome.slide.calibrated_m].map(|m| significant(m, 3));
    report
        .result("A simulated board with unknown errors was streamed, recorded, calibrated and corrected. It sent all data below.")
        .key("|f| − g on new tilts, rms", &format!("{before} → {after} mm/s²"))
        .key("position error after 3 s", &format!("{} → {} m", slide[0], slide[1]))
        .key(
            "samples replayed on the host",
            if exact { "bit for bit equal" } else { "different" },
        );
    report.printed(&story.join("\n"));
    for (_, chart) in charts {
        report.chart(chart);
    }
    if let Some(estimate) = &outcome.report.estimate {
        let (truth, found) = (outcome.truth.model.terms(), estimate.model.terms());
        let sd = estimate.sd();
        let rows: Vec<Vec<String>> = (0..3)
            .map(|axis| {
                vec![
                    ["X", "Y", "Z"][axis].to_owned(),
                    format!("{:+.4}", truth.bias_mps2[axis]),
                    format!("{:+.4} ± {:.4}", found.bias_mps2[axis], sd.bias_mps2[axis]),
                    format!("{:.5}", truth.matrix[axis][axis]),
                    format!("{:.5} ± {:.5}", found.matrix[axis][axis], sd.matrix[axis][axis]),
                ]
            })
            .collect();
        report.table(
            "Error model: truth and estimate",
            &["axis", "true bias (m/s²)", "estimate", "true scale factor", "estimate"],
            &rows,
        );
    }
    report
}
