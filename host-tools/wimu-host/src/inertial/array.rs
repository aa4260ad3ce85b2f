//! The path of several accelerometers on one body.

use wimu_nav::array::ArrayState;

use super::truth::{Nees, compare, moving, nees};
use super::{Choice, InertialPath, Method, PathPoint};
use crate::array::{Agreement, Array, ArrayBody, ArrayCalibration, ArrayGeometry};
use crate::imu::LIKELY;
use crate::stats::norm;
use crate::{Code, Problem, Result};

/// A centre nearer to the origin than this, m, is at it.
const CENTRED_M: f64 = 1e-3;
/// What the uncalibrated mean of an array's sensors may differ from gravity by, as a part of it.
const GRAVITY_SHARE: f64 = 0.2;

/// Navigates an array; `recording` is in body axes ([`Array::arranged`]). A size of the array that the motion contradicts
/// is a warning.
///
/// With [`Choice::smooth`] the angular rate is that from the whole recording. Attitude, velocity and position are those of the
/// filter.
///
/// # Errors
/// Those of [`ArrayBody`]; `data_refused` where the sensors contradict each other, what
/// they show at rest is not gravity, or no position is valid.
pub fn navigate_array(
    recording: &Array,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    choice: &Choice,
) -> Result<InertialPath> {
    let standard = wimu_model::STANDARD_GRAVITY_MPS2;
    let gravity = if calibration.uncalibrated.is_some() || calibration.stored {
        // Where biases may explain what it differs by, gravity is what it is.
        let mean = calibration.mean_rest_mps2(recording);
        let by_bias = LIKELY * calibration.bias_mps2 / (recording.sensors() as f64).sqrt();
        if (mean - standard).abs() < by_bias { standard } else { mean }
    } else {
        standard
    };
    if (gravity / standard - 1.0).abs() > GRAVITY_SHARE {
        return Err(Code::DataRefused
            .error(
                format!("the mean output at the rests is {gravity:.2} m/s², which is not gravity"),
                "check the unit in the columns' names (g, m/s², LSB) and --sensitivity",
            )
            .at(&recording.name));
    }
    let body = ArrayBody::of(recording, geometry, calibration)?;
    let (mut states, remarks) = body.navigated(gravity, choice.zupt)?;
    if choice.smooth {
        body.smooth_rates(&mut states, gravity, choice.zupt)?;
    }
    match &body.agreement {
        Some(agreement) => agreement.check(&recording.name)?,
        None => calibration.check(&recording.name)?,
    }
    let findings = body.agreement.as_ref().map_or_else(
        || {
            let text = "whether the sensors are where the geometry says was not checked: the array hardly turned, or its \
                        sensors are too few to contradict each other";
            vec![Code::Geometry.note(text)]
        },
        Agreement::findings,
    );
    let mut said = calibration.remarks();
    said.extend(point_of(geometry));
    let span = geometry.span_m();
    if span > ArrayGeometry::LARGE_M {
        said.push(format!("the array is {span:.1} m wide: are its places in m?"));
    }
    let said = said.into_iter().map(|text| Code::Geometry.note(text));
    path_of(recording, &states, choice, warnings(remarks).chain(findings).chain(said))
}

/// Which point the path is that of, where that is not the origin of the places.
fn point_of(geometry: &ArrayGeometry) -> Option<String> {
    let centre = geometry.centre_m();
    let off = norm(centre);
    (off > CENTRED_M).then(|| {
        let [x, y, z] = centre.map(|c| c * 1e3);
        format!(
            "the path is that of the centre of the sensors, at {x:.1} {y:.1} {z:.1} mm in the geometry, not of the \
             geometry's origin: as the body turns these move by up to {:.0} mm against each other",
            2e3 * off
        )
    })
}

fn warnings(texts: Vec<String>) -> impl Iterator<Item = Problem> {
    (texts.into_iter()).map(|text| Code::Navigation.warning(text))
}

fn deviations(covariance: &[[f64; 3]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| covariance[axis][axis].max(0.0).sqrt())
}

/// The path of an array whose states are these, against the truth where there is any.
fn path_of(
    recording: &Array,
    states: &[ArrayState],
    choice: &Choice,
    said: impl Iterator<Item = Problem>,
) -> Result<InertialPath> {
    let valid = |k: &usize| states[*k].valid && states[*k].position_sd_m() <= choice.limit_m;
    let points = states
        .iter()
        .zip(recording.times())
        .map(|(state, time)| PathPoint {
            time_s: time.s(),
            position_m: state.position_m,
            velocity_mps: state.velocity_mps,
            velocity_sd_mps: deviations(&state.velocity_covariance),
            attitude_sd_rad: deviations(&state.attitude_covariance),
            quaternion: state.quaternion,
            rate_rad_s: state.rate_rad_s,
            rate_covariance: Some(state.rate_covariance),
            covariance_m2: state.position_covariance,
            filtered_sd_m: state.position_sd_m(),
            resting: choice.zupt.is_on() && state.resting,
            valid: state.valid && state.position_sd_m() <= choice.limit_m,
        })
        .collect();
    let origin = (0..states.len()).find(valid).unwrap_or(0);
    let mut path = InertialPath::new(Method::Array, points, origin, choice.limit_m);
    path.smoothed_rate = choice.smooth;
    path.findings = warnings(recording.remarks.clone()).chain(said).collect();
    let ambiguous =
        states.iter().filter(|s| !s.resting && s.certainty > 0.0 && s.certainty < 0.99).count();
    if ambiguous > 0 {
        path.findings.push(Code::Navigation.warning(format!(
            "{ambiguous} samples fit several angular rates; rate and position are the means of all, with \
             their spread"
        )));
    }
    let field = if recording.has_magnetometer {
        "the array's method does not use the magnetometer"
    } else {
        "no magnetometer"
    };
    let text = format!("{field}: heading is that of the body at the start");
    path.findings.push(Code::Navigation.note(text));
    let mut path = path.checked(&recording.name, super::REMEDY)?;
    let truth = recording.truth();
    let true_rate = recording.beside(&recording.reference.rate_rad_s);
    let column = recording.reference.moving_on(recording.times());
    let moving = moving(&recording.times_s(), column.as_deref(), &truth, &true_rate);
    compare(&mut path, &truth, &moving);
    let valid = |k: &usize| path.points[*k].valid && moving.get(*k).is_some_and(|moves| *moves);
    let of_sample = |k: usize| {
        let (true_rate, state) = (true_rate[k]?, &states[k]);
        let error = std::array::from_fn(|i| state.rate_rad_s[i] - true_rate[i]);
        Some(nees(error, state.rate_covariance)).filter(|v| v.is_finite())
    };
    let rate_nees = (0..true_rate.len()).filter(valid).filter_map(of_sample).collect();
    let is_heading_fitted = path.nees.is_heading_fitted;
    path.rate_nees = Nees { all: rate_nees, is_heading_fitted };
    Ok(path.assumed(choice))
}
