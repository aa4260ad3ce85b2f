//! What is noticed of ranges: geometry, clock, calibration that is not observed.

use nalgebra::Vector3;

use super::hypotheses::{Chosen, LAST_SHIFT_S};
use super::model::Model;
use super::run::Run;
use super::start::principal_axes;
use super::{AnchorFound, Parameter, RangeRecording, Ranged};
use crate::digits::significant;
use crate::inertial::{gaps, one_clock};
use crate::plural::counted;
use crate::series::Ns;
use crate::stats::median;
use crate::{Code, Problem, Result};

/// Fewer ranges do not make a path.
const LEAST_RANGES: usize = 12;
/// A longer time without a range is reported, s.
const GAP_S: f64 = 3.0;

/// Refuses what cannot be solved, and reports gaps.
pub(super) fn before(recording: &RangeRecording) -> Result<Vec<Problem>> {
    let mut seen: Vec<usize> = recording.ranges.iter().map(|r| r.source).collect();
    seen.sort_unstable();
    seen.dedup();
    let moving = !recording.increments.is_empty() || recording.motion.is_some();
    let least = match (recording.planar, moving) {
        (true, true) => 1,
        (true, false) | (false, true) => 2,
        (false, false) => 3,
    };
    let count = recording.ranges.len();
    let (message, remedy) = if seen.len() < least {
        let message = format!(
            "ranges to {} do not determine a position: {least} are needed",
            counted(seen.len(), "anchor")
        );
        (message, "add anchors, or wheel odometry (--odometry)")
    } else {
        let message = format!("{count} ranges are too few: {LEAST_RANGES} are needed");
        (message, "record for longer")
    };
    if seen.len() < least || count < LEAST_RANGES {
        return Err(Code::DataRefused.error(message, remedy).at(&recording.name));
    }
    let times_s: Vec<f64> = recording.ranges.iter().map(|range| range.time_s).collect();
    let mut found: Vec<Problem> = gaps(&times_s, "range", GAP_S).into_iter().collect();
    let anchors = recording.anchors.iter().enumerate();
    let silent = anchors.filter(|(k, _)| !seen.contains(k));
    let silent: Vec<&str> = silent.map(|(_, anchor)| anchor.id.as_str()).collect();
    if !silent.is_empty() {
        let text = format!("no range to anchor {}", silent.join(", "));
        found.push(Code::Navigation.note(text));
    }
    Ok(found)
}

/// Anchors are on a line if they are off it by less than this part of their distance along it: a dilution of 20.
const LINE: f64 = 0.05;
/// Ranges longer or shorter than the extent of the anchors by this factor have probably another unit.
const FAR: f64 = 20.0;

/// What to do where no position is known to the limit.
pub(super) fn remedy(
    recording: &RangeRecording,
    anchors_m: &[Vector3<f64>],
    is_mirrored: bool,
) -> String {
    let centre = anchors_m.iter().sum::<Vector3<f64>>() / anchors_m.len() as f64;
    let axes = principal_axes(anchors_m, &centre);
    let extent = |axis: usize| {
        let along = anchors_m.iter().map(|a| (a - centre).dot(&axes.column(axis)).abs());
        2.0 * along.fold(0.0, f64::max)
    };
    let ranges_m = recording.ranges.iter().map(|r| r.value[0]);
    let median_m = median(ranges_m).unwrap_or_default();
    if median_m > FAR * extent(0) || FAR * median_m < extent(0) {
        let [median, extent] = [median_m, extent(0)].map(|length| significant(length, 3));
        format!("check the units: the ranges are {median} m, the anchors within {extent} m")
    } else if !recording.planar && extent(1) < LINE * extent(0) {
        "the anchors are on a line: move one out of it, or leave out `Position U`".to_owned()
    } else if is_mirrored {
        SIDE.to_owned()
    } else {
        "give a larger `limit_m` (--setup), or put anchors on more sides".to_owned()
    }
}

/// What to do about a path that may be its mirror image.
pub(super) const SIDE: &str = "give the side with --start E,N,U, move an anchor out of the plane, or leave out `Position U` where the unit is as high as \
                               the anchors";

/// What a run shows.
pub(super) fn after(recording: &RangeRecording, run: &Run, chosen: &Chosen) -> Vec<Problem> {
    let mut found = Vec::new();
    if let Some(other) = &chosen.other {
        let at = |p: &Vector3<f64>| format!("E {:.2} N {:.2} U {:.2} m", p.x, p.y, p.z);
        let geometry = if recording.planar { "on a line" } else { "in a plane" };
        let text = format!(
            "two starts are equally probable, {} (used) and {}: the anchors are {geometry}, and the path may be the mirror image",
            at(&chosen.start.position_m),
            at(&other.position_m)
        );
        found.push(Code::NotObserved.warning(text).remedy(SIDE));
    }
    if chosen.start.inverted {
        let text = "gravity is along the up axis of the anchors: their frame points down";
        found.push(Code::Axes.note(text));
    }
    found.extend(run.navigator.findings());
    found
}

/// A clock that is off by a time, s: corrected where that explains the ranges.
pub(super) fn clock(shift_s: f64, explains: bool) -> Problem {
    if !explains {
        let text = format!(
            "the ranges do not fit the other sensor, at any clock offset within ± {LAST_SHIFT_S} s: the path may be wrong"
        );
        let remedy = "give both the times of one clock; check axes and signs of the other sensor";
        return Code::Clock.warning(text).remedy(remedy);
    }
    let text = format!(
        "the clock of the ranges is off by {:+.2} s from that of the other sensor: corrected",
        -shift_s
    );
    let remedy = format!("add {shift_s:+.2} s to the times of the ranges");
    Code::Clock.warning(text).remedy(remedy)
}

/// The best clock offset is at the end of the search.
pub(super) fn last_shift(shift_s: f64) -> Problem {
    let end = LAST_SHIFT_S.copysign(-shift_s);
    let message = format!(
        "the clock of the ranges is off by {end:+} s or more from that of the other sensor, the end of the search"
    );
    Code::DataRefused.error(message, "give both the times of one clock")
}

/// Refuses ranges of which none is within the time of the other sensor.
pub(super) fn same_time(recording: &RangeRecording) -> Result<()> {
    let ranges = ends(&recording.ranges, |range| range.time_s);
    let wheels = ends(&recording.increments, |increment| increment.time_s);
    let motion = recording.motion.as_ref();
    let motion = motion.and_then(|motion| motion.samples.span()).map(|span| span.map(Ns::s));
    for (what, other) in [("odometry", wheels), ("inertial samples", motion)] {
        if let (Some(ranges), Some(other)) = (ranges, other) {
            one_clock([("ranges", ranges), (what, other)]).map_err(|e| e.at(&recording.name))?;
        }
    }
    Ok(())
}

/// Times of the first and the last element, s.
fn ends<T>(all: &[T], time_s: impl Fn(&T) -> f64) -> Option<[f64; 2]> {
    Some([time_s(all.first()?), time_s(all.last()?)])
}

/// Calibration parameters that the data do not show.
pub(super) fn unobserved(found: &Ranged) -> Vec<Problem> {
    let hidden = |what: &str, unit: &str, of: fn(&AnchorFound) -> Option<Parameter>| {
        let anchors = found.anchors.iter().filter(|a| a.ranges > 0);
        let hidden = anchors.filter_map(|a| Some((a.id.as_str(), of(a)?)));
        let hidden = hidden.filter(|(_, parameter)| !parameter.is_observed());
        let (names, parameters): (Vec<&str>, Vec<Parameter>) = hidden.unzip();
        let text = format!(
            "{what} of anchor {} not observed: it stays near its prior, 0 ± {}{unit}",
            names.join(", "),
            significant(parameters.first()?.prior, 2)
        );
        let remedy = "move through more of the space between the anchors";
        Some(Code::NotObserved.note(text).remedy(remedy))
    };
    let bias = hidden("bias", " m", |anchor| anchor.bias_m);
    let scale = hidden("scale error", "", |anchor| anchor.scale);
    bias.into_iter().chain(scale).collect()
}

/// Biases that the other anchors do not have.
pub(super) fn unlike(recording: &RangeRecording, run: &Run, model: &Model) -> Option<Problem> {
    let one =
        |(index, bias_m): (usize, f64)| format!("{} {bias_m:+.2} m", recording.anchors[index].id);
    let named: Vec<String> = run.unlike_biases(model).map(one).collect();
    let text = format!(
        "bias of anchor {}: unlike that of the others, and the path may be wrong",
        named.join(", ")
    );
    let remedy = "see that it stands where the file has it, in line of sight, and calibrate its antenna delay";
    (!named.is_empty()).then(|| Code::Residuals.warning(text).remedy(remedy))
}
