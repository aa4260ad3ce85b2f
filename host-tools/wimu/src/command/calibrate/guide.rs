//! Guided calibration of a live board in text: rows that are redrawn at a terminal, lines elsewhere.

use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use wimu_host::Result;
use wimu_host::calibration::CalibrateOptions;
use wimu_host::digits::significant;
use wimu_host::guided::{DEFAULT_FILE, Guided, GuidedView, Hold, Plan, Uncertainty};
use wimu_host::recording::Selection;
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::arguments::{Calibrate, Method};
use crate::command::{Connection, connect_for, interrupted, params};
use crate::output::Output;
use crate::text_view::{TextView, typed};

/// Longest wait for data before typed lines are read.
const GLANCE: Duration = Duration::from_millis(50);
/// Largest tilt from the next orientation that counts as reached, degrees. Chosen: any orientation is accepted.
const REACHED_DEG: f64 = 10.0;
/// Characters of a bar.
const BAR: usize = 20;

/// Why the collection of poses ended.
#[derive(PartialEq, Eq)]
pub enum End {
    /// All were captured, or the person wants the result.
    Finished,
    /// The person wants no result now.
    Quit,
}

/// Calibrates a board. Returns the exit code.
pub fn run(arguments: &Calibrate, options: &CalibrateOptions, output: &Output) -> Result<u8> {
    let mut client = connect_for(&arguments.input, arguments.push)?;
    let mut guided = begin(&client, arguments, options)?;
    let lines = typed();
    loop {
        let collected = collect(&mut client, &mut guided, &lines, output);
        if !matches!(collected, Ok(End::Finished)) {
            output.print(guided.end().unwrap_or_default());
            return collected.map(|_| 0);
        }
        guided.calibrate()?;
        let Some(report) = guided.report() else { return Ok(0) };
        let data = guided.recording()?;
        let samples = data.samples(Selection::default())?;
        let code = super::finish_with_page(arguments, report, Some(&samples), output)?;
        let answer =
            if arguments.push { Answer::Push } else { question(&lines, code == 0, output)? };
        if answer == Answer::More {
            guided.more();
            continue;
        }
        let wants_push = code == 0 && answer == Answer::Push;
        if let (true, Some(set)) = (wants_push, &report.parameters) {
            params::push(&mut client, set, output)?;
        }
        if wants_push || (code == 0 && arguments.output.is_some()) {
            guided.forget_poses();
        }
        return Ok(code);
    }
}

/// A session for the board of `client`.
pub fn begin(
    client: &Connection,
    arguments: &Calibrate,
    options: &CalibrateOptions,
) -> Result<Guided> {
    let file = arguments.output.as_deref().unwrap_or(Path::new(DEFAULT_FILE));
    let (count, hello) = (arguments.count.map(usize::from), client.hello());
    let plan = match arguments.method {
        Method::Magnetometer => Plan::of_field(count, hello),
        _ => Plan::new(options, count, hello),
    };
    let plan = plan.map_err(|error| error.at(client.name()))?;
    let mut guided = Guided::new(plan, hello, client.name(), file);
    guided.saves = arguments.output.is_some();
    Ok(guided)
}

/// Collects poses until there are enough, the person ends it, or Ctrl-C. Without a terminal Ctrl-C asks for the result of
/// the poses so far.
pub fn collect(
    client: &mut Connection,
    guided: &mut Guided,
    lines: &Receiver<String>,
    output: &Output,
) -> Result<End> {
    let stop = interrupted()?;
    let mut view = TextView::open(output);
    guided.saves |= view.is_some();
    let mut printed = [String::new(), String::new()];
    while !guided.is_due() {
        if stop.load(Ordering::Relaxed) {
            return Ok(if view.is_some() { End::Quit } else { End::Finished });
        }
        for line in lines.try_iter() {
            if let Some(end) = key(guided, &line) {
                return Ok(end);
            }
        }
        let captured = match client.next_event(GLANCE)? {
            Some(arrival) => guided.take_arrivals(std::slice::from_ref(&arrival)),
            None => false,
        };
        guided.refresh();
        let Some(view) = &mut view else {
            let lines = [("", &guided.view.message), ("next: ", &guided.view.instruction)];
            for ((label, line), before) in lines.into_iter().zip(&mut printed) {
                if !line.is_empty() && line != before {
                    output.print(format!("{label}{line}"));
                    before.clone_from(line);
                }
            }
            continue;
        };
        if captured {
            view.bell();
        }
        if !view.draw(|| rows(&guided.view)) {
            return Ok(End::Quit);
        }
    }
    Ok(End::Finished)
}

/// Does what a typed line asks for; returns whether that ends the collection.
fn key(guided: &mut Guided, line: &str) -> Option<End> {
    match line {
        "q" => return Some(End::Quit),
        "f" => return Some(End::Finished),
        "u" => guided.undo(),
        "s" => guided.skip(),
        _ => {}
    }
    None
}

#[derive(PartialEq, Eq)]
enum Answer {
    Push,
    More,
    Quit,
}

/// Asks a person at a terminal what is to follow the result.
fn question(lines: &Receiver<String>, usable: bool, output: &Output) -> Result<Answer> {
    let stop = interrupted()?;
    let push = if usable { "p pushes it to the board, " } else { "" };
    let mut asked = false;
    while !stop.load(Ordering::Relaxed) {
        match lines.recv_timeout(GLANCE) {
            Ok(line) if line == "p" && usable => return Ok(Answer::Push),
            Ok(line) if line == "m" => return Ok(Answer::More),
            Ok(line) if line == "q" => break,
            Err(RecvTimeoutError::Disconnected) => break,
            _ if asked => {}
            _ => {
                output.print(format!("{push}m captures more poses, q quits (then Enter)"));
                asked = true;
            }
        }
    }
    Ok(Answer::Quit)
}

/// The rows of a view.
fn rows(view: &GuidedView) -> Vec<String> {
    let mut rows = vec![
        format!("{}: pose {} of {}", view.device, view.poses.len(), view.wanted),
        String::new(),
        format!("next   {}", view.instruction),
        "       Any other orientation serves as well: hold the board still until the bell."
            .to_owned(),
        format!("now    {}", tilt(view)),
        format!("       {}", hold(view.hold)),
        String::new(),
    ];
    if let Some(latest) = view.uncertainty.last() {
        rows.extend(uncertainty(latest));
    }
    rows.extend([
        String::new(),
        view.message.clone(),
        String::new(),
        "u undo, s skip, f finish now, q quit (then Enter); poses are kept".to_owned(),
    ]);
    rows
}

/// The present tilt from the next orientation.
fn tilt(view: &GuidedView) -> String {
    let (Some(up), Some(next)) = (view.up, view.next) else {
        return String::new();
    };
    let along: f64 = (0..3).map(|k| up[k] * next[k]).sum();
    let angle = along.clamp(-1.0, 1.0).acos().to_degrees();
    let shown = bar(1.0 - angle / 180.0);
    if angle <= REACHED_DEG {
        return format!("{shown} {angle:.0}° from it: reached");
    }
    // The axis that misses most of the next orientation.
    let missing = [0, 1, 2].map(|k| next[k] - along * up[k]);
    let axis = (0..3).max_by(|a, b| missing[*a].abs().total_cmp(&missing[*b].abs())).unwrap_or(0);
    let side = view.sides[2 * axis + usize::from(missing[axis] < 0.0)];
    format!("{shown} {angle:.0}° from it: raise its {side}")
}

fn hold(hold: Hold) -> String {
    match hold {
        Hold::Waiting => format!("{} waiting for samples", bar(0.0)),
        Hold::Moving => format!("{} moving: hold it still", bar(0.0)),
        Hold::Holding(so_far, whole) => {
            let left = (whole - so_far).max(0.0);
            format!("{} still: {left:.1} s more", bar(so_far / whole))
        }
        Hold::Captured => format!("{} captured: rotate it to the next orientation", bar(1.0)),
    }
}

/// A bar of a fraction, 0 to 1.
fn bar(fraction: f64) -> String {
    let filled = (fraction.clamp(0.0, 1.0) * BAR as f64).round() as usize;
    format!("[{}{}]", "#".repeat(filled), " ".repeat(BAR - filled))
}

/// Standard deviations of bias and scale factor.
fn uncertainty(latest: &Uncertainty) -> Vec<String> {
    let axes = |values: [f64; 3], factor: f64, unit: &str| {
        let [x, y, z] = values.map(|value| significant(value * factor, 2));
        format!("± {x} X, {y} Y, {z} Z {unit}")
    };
    let mut rows = vec![
        format!("bias          {}", axes(latest.bias_mps2, 1e3 / STANDARD_GRAVITY_MPS2, "mg")),
        format!("scale factor  {}", axes(latest.scale, 100.0, "%")),
    ];
    rows.extend(latest.no_fit.as_ref().map(|why| format!("expected; no fit yet: {why}")));
    rows
}
