//! What a parameter set holds beside the error model.

use proptest::prelude::*;
use wimu_model::{
    Alignment, CalibratedTemperature, CalibrationMethod, CalibrationQuality, CovarianceError,
    GyroscopeModel, GyroscopeParameters, MagneticFieldNt, MagnetometerModel, MagnetometerRotation,
    MagnetometerTerms, ModelCovariance, ModelError, ParameterSet, QualityTerms, RotationCovariance,
    Sensitivity, TermDeviations,
};

fn quality() -> QualityTerms {
    QualityTerms {
        method: CalibrationMethod::MultiPosition,
        utc_s: Some(1_795_222_920),
        temperature: Some(CalibratedTemperature { mean_c: 24.5, lowest_c: 20.0, highest_c: 30.0 }),
        poses: 13,
        dof: 4,
        rms_mps2: 0.0012,
        loo_rms_mps2: Some(0.003),
        condition: Some(2.5),
        covariance: ModelCovariance::from_matrix(&std::array::from_fn(|a| {
            std::array::from_fn(|b| if a == b { 1e-6 / 3.0 } else { 0.0 })
        }))
        .unwrap(),
        other_sd: TermDeviations::default(),
    }
}

fn magnetometer() -> MagnetometerTerms {
    MagnetometerTerms {
        hard_iron_nt: [12_000.0, -3000.0, 800.0],
        hard_iron_sd_nt: [50.0; 3],
        soft_iron: [1.1, 0.9, 1.02, 0.05, -0.02, 0.03],
        soft_iron_sd: [0.001; 6],
        field_nt: 48_300.0,
        poses: 20,
        rms_nt: 120.0,
        loo_rms_nt: 140.0,
        condition: 3.0,
        to_accelerometer: Some(MagnetometerRotation {
            rotation: Alignment::from_quaternion([0.5, 0.5, 0.5, 0.5]).unwrap(),
            covariance: RotationCovariance::ZERO,
            dip_rad: 1.1,
            dip_rms_rad: 0.01,
        }),
    }
}

fn gyroscope(
    range_dps: u16,
    rad_s_per_lsb: f64,
    sd: Option<[f32; 12]>,
) -> Result<GyroscopeParameters, ModelError> {
    GyroscopeParameters::new(range_dps, rad_s_per_lsb, GyroscopeModel::default(), sd)
}

fn set() -> ParameterSet {
    ParameterSet {
        quality: Some(CalibrationQuality::new(quality()).unwrap()),
        alignment: Alignment::from_quaternion([0.9, 0.1, -0.2, 0.3]).unwrap(),
        alignment_covariance: Some(
            RotationCovariance::from_matrix(&[
                [4e-6, 0.0, 0.0],
                [0.0, 9e-6, 0.0],
                [0.0, 0.0, 1e-4],
            ])
            .unwrap(),
        ),
        magnetometer: Some(MagnetometerModel::new(magnetometer()).unwrap()),
        sensor_index: 1,
        gyroscope: Some(gyroscope(500, 0.0003, Some([0.01; 12])).unwrap()),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0 / 12.0).unwrap())
    }
}

proptest! {
    #[test]
    fn a_covariance_comes_back_and_is_always_one(
        factor in prop::collection::vec(-1.0..1.0_f64, 78),
        unfitted in 0_usize..12,
    ) {
        let mut l = [[0.0; 12]; 12];
        let mut next = factor.into_iter();
        for row in 0..12 {
            for column in 0..=row {
                l[row][column] = next.next().unwrap();
            }
        }
        l[unfitted] = [0.0; 12];
        let product = |a: usize, b: usize| (0..12).map(|k| l[a][k] * l[b][k]).sum::<f64>();
        let matrix: [[f64; 12]; 12] =
            std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)));
        let covariance = ModelCovariance::from_matrix(&matrix).unwrap();
        for a in 0..12 {
            for b in 0..12 {
                prop_assert!((covariance.get(a, b) - matrix[a][b]).abs() < 1e-5);
            }
            prop_assert!((covariance.sd(a) - matrix[a][a].sqrt()).abs() < 1e-5);
        }
        prop_assert_eq!(covariance.sd(unfitted), 0.0);
        prop_assert_eq!(ModelCovariance::from_factor(covariance.factor()), Ok(covariance));
    }

    #[test]
    fn correcting_the_field_undoes_iron_and_rotation(field in prop::array::uniform3(-60_000.0..60_000.0_f64)) {
        let model = MagnetometerModel::new(magnetometer()).unwrap();
        let s = model.soft_iron();
        let hard = model.terms().hard_iron_nt;
        // The rotation takes X to Y, Y to Z and Z to X: in magnetometer axes (y, z, x).
        let own = [field[1], field[2], field[0]];
        let output = MagneticFieldNt(std::array::from_fn(|axis| {
            let row: f64 = (0..3).map(|k| s[axis][k] * own[k]).sum();
            (row + f64::from(hard[axis])).round() as i32
        }));
        let found = model.correct_to_accelerometer(output).unwrap();
        for axis in 0..3 {
            prop_assert!((found[axis] - field[axis]).abs() < 2.0, "{found:?} {field:?}");
        }
        let body = ParameterSet { alignment: Alignment::IDENTITY, ..set() };
        prop_assert_eq!(body.correct_field(output), Some(found));
        prop_assert_eq!(ParameterSet { magnetometer: None, ..body }.correct_field(output), None);
    }
}

#[test]
fn a_covariance_may_be_nearly_singular() {
    for conditional_sd in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 0.0] {
        let factor = |row: usize, column: usize| match row.checked_sub(column) {
            Some(0) => conditional_sd,
            Some(apart) => 1.0 / (apart + 1) as f64,
            None => 0.0,
        };
        let matrix: [[f64; 12]; 12] = std::array::from_fn(|a| {
            std::array::from_fn(|b| (0..12).map(|k| factor(a, k) * factor(b, k)).sum())
        });
        let covariance = ModelCovariance::from_matrix(&matrix).expect("a covariance");
        for (a, b) in (0..12).flat_map(|a| (0..12).map(move |b| (a, b))) {
            let rounding = (covariance.get(a, b) - matrix[a][b]).abs();
            assert!(rounding < 1e-6, "{conditional_sd}: {a} {b}: {rounding:e}");
        }
    }
}

#[test]
fn what_is_no_covariance_is_refused() {
    let diagonal = |variance: f64| [[variance, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for wrong in [
        diagonal(-1.0),
        diagonal(f64::NAN),
        diagonal(1e9),
        [[1.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    ] {
        assert_eq!(RotationCovariance::from_matrix(&wrong), Err(CovarianceError));
    }
    assert!(RotationCovariance::from_factor([[f32::NAN; 6]]).is_err());
}

#[test]
fn what_a_calibration_says_of_itself_is_within_bounds() {
    let wrong = |change: &dyn Fn(&mut QualityTerms)| {
        let mut terms = quality();
        change(&mut terms);
        named(CalibrationQuality::new(terms).unwrap_err())
    };
    let cold = |q: &mut QualityTerms| q.temperature.as_mut().unwrap().lowest_c = -300.0;
    assert_eq!(wrong(&cold), "lowest temperature");
    assert_eq!(wrong(&|q| q.rms_mps2 = f32::NAN), "residual");
    assert_eq!(wrong(&|q| q.loo_rms_mps2 = Some(-0.1)), "residual");
    assert_eq!(wrong(&|q| q.condition = Some(0.0)), "condition");
    assert_eq!(wrong(&|q| q.other_sd.nonlinearity[2] = 2.0), "standard deviation");
}

/// What an error names.
fn named(error: ModelError) -> &'static str {
    match error {
        ModelError::OutOfBounds { name, .. } | ModelError::Singular { name, .. } => name,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_gyroscopes_parameters_are_within_bounds() {
    let term = |found: Result<_, _>| named(found.unwrap_err());
    assert_eq!(term(gyroscope(0, 0.001, None)), "gyroscope range");
    for rad_s_per_lsb in [0.0, -0.001, 0.1, f64::NAN] {
        assert_eq!(term(gyroscope(500, rad_s_per_lsb, None)), "gyroscope sensitivity");
    }
    for sd in [-1.0, 2.0, f32::NAN] {
        let found = gyroscope(500, 0.001, Some([sd; 12]));
        assert_eq!(term(found), "standard deviation of the gyroscope");
    }
}

#[test]
fn a_magnetometer_model_can_always_be_inverted() {
    let wrong = |change: &dyn Fn(&mut MagnetometerTerms)| {
        let mut terms = magnetometer();
        change(&mut terms);
        named(MagnetometerModel::new(terms).unwrap_err())
    };
    assert_eq!(wrong(&|m| m.hard_iron_nt[1] = f32::INFINITY), "hard iron");
    assert_eq!(wrong(&|m| m.soft_iron[0] = -1.0), "soft iron");
    // Symmetric with a positive diagonal, but not positive definite.
    assert_eq!(wrong(&|m| m.soft_iron[5] = 1.5), "the soft iron");
    assert_eq!(wrong(&|m| m.field_nt = 10.0), "field");
    assert_eq!(wrong(&|m| m.hard_iron_sd_nt[0] = -1.0), "standard deviation of the magnetometer");
    let far = |m: &mut MagnetometerTerms| m.to_accelerometer.as_mut().unwrap().dip_rad = 1.6;
    assert_eq!(wrong(&far), "dip");
}

#[cfg(feature = "serde")]
#[test]
fn a_parameter_set_comes_back_from_json_bit_for_bit_and_a_bad_one_does_not() {
    let set = set();
    let text = serde_json::to_string(&set).unwrap();
    assert_eq!(serde_json::from_str::<ParameterSet>(&text).unwrap(), set);
    for (good, bad) in [
        ("\"condition\":2.5", "\"condition\":0.1"),
        ("\"bias_m_s2\":[0.0", "\"bias_m_s2\":[99.0"),
        ("48300.0", "0.0"),
    ] {
        assert!(text.contains(good), "{text}");
        let bad = text.replace(good, bad);
        assert!(serde_json::from_str::<ParameterSet>(&bad).is_err());
    }
}
