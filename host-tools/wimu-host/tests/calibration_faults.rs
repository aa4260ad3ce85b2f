//! Faults of a calibration session: whether the first finding names them, and how often sound sessions get one.

use std::collections::BTreeMap;

use wimu_calib::Orientation;
use wimu_host::calibration::{CalibrateOptions, CalibrationReport, calibrate};
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_host::{Code, Problem, Severity};
use wimu_model::{ErrorModel, ErrorTerms, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
use wimu_testkit::{Random, figure, trials};

const G: f64 = STANDARD_GRAVITY_MPS2;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    None,
    ColdStart,
    BiasStep,
    GainChange,
    SignFlip,
    Sensitivity,
    SensitivityFar,
    Normalised,
}

impl Fault {
    const ALL: [Self; 7] = [
        Self::ColdStart,
        Self::BiasStep,
        Self::GainChange,
        Self::SignFlip,
        Self::Sensitivity,
        Self::SensitivityFar,
        Self::Normalised,
    ];

    /// The code that should rank first; `None` where there should be no warning.
    fn code(self) -> Option<Code> {
        match self {
            Self::None => None,
            Self::ColdStart => Some(Code::Drift),
            Self::BiasStep | Self::GainChange | Self::SignFlip => Some(Code::Step),
            Self::Sensitivity | Self::SensitivityFar => Some(Code::Sensitivity),
            Self::Normalised => Some(Code::AlreadyCorrected),
        }
    }
}

/// A sensor of a consumer's accuracy: bias up to 60 mg, scale factor ±4 %, misalignment ±20 mrad.
fn sensor(random: &mut Random, fault: Fault) -> ErrorTerms {
    let mut terms = ErrorTerms::default();
    // A sign that changes shows in the bias and the misalignments alone: larger ones are refused, smaller ones harmless.
    let [bias, misalignment] = match fault {
        Fault::SignFlip => [0.06, 0.006],
        _ => [0.6, 0.02],
    };
    for row in 0..3 {
        terms.bias_mps2[row] = match fault {
            Fault::SignFlip => {
                (0.5 * bias + 0.5 * random.within(bias).abs()) * [-1.0, 1.0][random.below(2)]
            }
            _ => random.within(bias),
        };
        terms.matrix[row][row] += random.within(0.04);
        for column in 0..row {
            terms.matrix[row][column] = random.within(misalignment);
        }
    }
    terms
}

/// Pose means: time, s; counts at 2048 LSB/g.
struct Session {
    rows: Vec<(f64, [f64; 3])>,
    options: CalibrateOptions,
}

/// The twelve edges that the guide recommends, held to 8° rms, and random directions, in any order.
fn directions(random: &mut Random, count: usize) -> Vec<[f64; 3]> {
    let edges = Orientation::ALL.into_iter().map(Orientation::up);
    let edges = edges.filter(|up| up.iter().filter(|c| **c == 0.0).count() == 1);
    let edges: Vec<[f64; 3]> = edges.collect();
    let mut ups: Vec<[f64; 3]> = (0..count)
        .map(|k| match edges.get(k) {
            Some(edge) => {
                let off = random.normals(0.1);
                [0, 1, 2].map(|axis| edge[axis] + off[axis])
            }
            None => random.direction(),
        })
        .collect();
    for k in (1..count).rev() {
        ups.swap(k, random.below(k + 1));
    }
    ups.into_iter()
        .map(|up| {
            let norm = up.iter().map(|c| c * c).sum::<f64>().sqrt();
            up.map(|c| c / norm)
        })
        .collect()
}

fn session(seed: u64, count: usize, fault: Fault) -> Session {
    let mut random = Random::new(seed);
    let terms = sensor(&mut random, fault);
    let scatter = 0.001 + 0.005 * random.uniform();
    let begin = (0.3 + 0.4 * random.uniform()) * count as f64;
    let axis = random.below(3);
    let mut drift = [0.0; 3];
    for change in &mut drift {
        *change = (0.02 + 0.04 * random.uniform()) * [-1.0, 1.0][random.below(2)];
    }
    let time_constant = 0.15 + 0.35 * random.uniform();
    let side = [-1.0, 1.0][random.below(2)];
    let factor = match fault {
        Fault::Sensitivity => 1.0 / (1.0 + side * (0.13 + 0.07 * random.uniform())),
        Fault::SensitivityFar if side > 0.0 => 2.0,
        Fault::SensitivityFar => 0.5,
        _ => 1.0,
    };
    let options = CalibrateOptions {
        gravity_mps2: Some(G),
        sensitivity_lsb_per_g: Some(2048.0 * factor),
        range_g: Some(16),
        ..CalibrateOptions::default()
    };
    let ups = directions(&mut random, count);
    let mut rows = Vec::new();
    let mut time = 0.0;
    for k in 0..count {
        time += 8.0 + 8.0 * random.uniform();
        let progress = k as f64 / (count - 1) as f64;
        let late = k as f64 >= begin;
        let mut terms = terms;
        if late && fault == Fault::BiasStep {
            terms.bias_mps2[axis] += 0.05 * side;
        }
        if late && fault == Fault::GainChange {
            terms.matrix[axis][axis] += 0.02 * side;
        }
        if fault == Fault::ColdStart {
            for (bias, change) in terms.bias_mps2.iter_mut().zip(drift) {
                *bias += change * (-progress / time_constant).exp();
            }
        }
        let truth = ErrorModel::new(terms).expect("within bounds");
        let force = SpecificForceMps2(ups[k].map(|c| c * G));
        let mut y = truth.distort(force, None).0;
        if late && fault == Fault::SignFlip {
            y[axis] = -y[axis];
        }
        for y in &mut y {
            *y += scatter * random.normal();
        }
        if fault == Fault::Normalised {
            let norm = y.iter().map(|c| c * c).sum::<f64>().sqrt();
            y = y.map(|c| c / norm * G);
        }
        rows.push((time, y.map(|c| c * 2048.0 / G)));
    }
    Session { rows, options }
}

fn run(session: &Session, options: &CalibrateOptions) -> CalibrationReport {
    let mut recording = Recording::new("poses");
    let unit = Unit::Counts { si_per_lsb: None };
    let force = TrackInfo::new("poses", Quantity::SpecificForce, unit);
    let force = recording.track(force);
    for (time, value) in &session.rows {
        recording.row(force, (time * 1e9) as i64, value);
    }
    let selection = Selection { accelerometer: None, poses: true };
    let data = recording.samples(selection).expect("poses");
    calibrate(&data, options).expect("options")
}

/// Findings of severity warning or higher, in the order in which they are printed; a refusal by the code of its cause.
fn warnings(report: &CalibrationReport) -> Vec<&Problem> {
    let severe = |finding: &&Problem| {
        finding.severity >= Severity::Warning && finding.code != Code::NoResult
    };
    report.outcome.findings.iter().filter(severe).collect()
}

/// Whether the first warning names the fault; for a refusal, whether the reason does.
fn is_named(report: &CalibrationReport, fault: Fault) -> bool {
    let refused = |part: &str| {
        let reason = report.outcome.reason.as_deref();
        reason.is_some_and(|reason| reason.contains(part))
    };
    match fault {
        Fault::SensitivityFar => refused("2048 LSB/g is likely"),
        Fault::Normalised => refused("normalised"),
        _ => warnings(report).first().map(|finding| finding.code) == fault.code(),
    }
}

#[test]
fn the_first_finding_names_the_fault() {
    let mut counts: BTreeMap<Fault, [usize; 4]> = BTreeMap::new();
    let sessions = trials(500);
    for seed in 0..sessions {
        let fault = Fault::ALL[seed % Fault::ALL.len()];
        let session = session(50_000 + seed as u64, 16 + seed % 15, fault);
        let report = run(&session, &session.options);
        let [all, named, many, refused] = counts.entry(fault).or_default();
        *all += 1;
        *named += usize::from(is_named(&report, fault));
        *many += usize::from(warnings(&report).len() > 2);
        *refused += usize::from(report.estimate.is_none());
        if !is_named(&report, fault) || warnings(&report).len() > 2 {
            println!("{fault:?} {seed}: {:?}", report.outcome.reason);
            for finding in warnings(&report) {
                println!("    {:?}: {finding}", finding.code);
            }
        }
    }
    let mut named = 0;
    let mut many = 0;
    for (fault, [all, first, more, refused]) in counts {
        println!("{fault:?}: {first} of {all} named, {refused} refused, {more} with more than two");
        named += first;
        many += more;
    }
    let fraction = named as f64 / sessions as f64;
    figure(
        &format!("{sessions} sessions with a fault: the first finding names it"),
        format!("{:.1} %", 100.0 * fraction),
        "at least 90 %",
        fraction >= 0.9,
    );
    figure(
        &format!("{sessions} sessions with a fault: more than two findings"),
        many,
        "0",
        many == 0,
    );
    assert!(fraction >= 0.9 && many == 0, "{fraction}, {many}");
}

#[test]
fn a_sound_session_has_no_warning() {
    let sessions = trials(500);
    let mut warned = 0;
    for seed in 0..sessions {
        let session = session(70_000 + seed as u64, 12 + seed % 19, Fault::None);
        let report = run(&session, &session.options);
        let warnings = warnings(&report);
        if !warnings.is_empty() || report.estimate.is_none() {
            warned += 1;
            println!("{seed}: {:?} {warnings:?}", report.outcome.reason);
        }
    }
    let fraction = warned as f64 / sessions as f64;
    figure(
        &format!("{sessions} sound sessions: a warning or a refusal"),
        format!("{:.1} %", 100.0 * fraction),
        "at most 1 %",
        fraction <= 0.01,
    );
    assert!(fraction <= 0.01_f64.max(1.5 / sessions as f64), "{fraction}");
}

#[test]
fn a_pose_that_is_left_out_does_not_change_the_grade() {
    let error = |session: &Session| {
        let report = run(session, &session.options);
        let estimate = report.estimate.expect("an estimate");
        let left_out = estimate.loo_rms_mps2.expect("of many poses") * 1e3;
        let grade = report.grade.expect("of an estimate");
        (estimate.rejected.len(), grade.error_mm_s2, left_out)
    };
    let mut session = session(80_000, 20, Fault::None);
    let (rejected, grade, left_out) = error(&session);
    assert_eq!(rejected, 0);
    let bad = session.rows[7].1.map(|y| 1.01 * y);
    session.rows.push((400.0, bad));
    let (rejected, with_bad, left_out_with_bad) = error(&session);
    assert_eq!(rejected, 1);
    assert!((with_bad / grade - 1.0).abs() < 1e-6, "{with_bad} {grade}");
    assert!((left_out_with_bad / left_out - 1.0).abs() < 1e-6, "{left_out_with_bad} {left_out}");
}
