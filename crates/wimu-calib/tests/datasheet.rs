//! What a sensor shows beside what its datasheet promises.

use crate::common;

use common::{G, NINE, Random, exact, pose, twelve};
use wimu_calib::{
    Datasheet, Face, Finding, MultiPosition, Orientation, Placement, Pose, Quantity, Term, Terms,
    Verdict, four_angle, multi_position, six_position,
};
use wimu_model::{CentiCelsius, ErrorModel, ErrorTerms, SpecificForceMps2};

fn model(terms: ErrorTerms) -> ErrorModel {
    ErrorModel::new(terms).expect("within bounds")
}

fn of(findings: &[Finding], quantity: Quantity) -> Vec<Finding> {
    let of_it = findings.iter().filter(|f| f.quantity == quantity);
    of_it.copied().collect()
}

#[test]
fn every_sensor_is_found_by_its_name_however_it_is_written() {
    for known in Datasheet::KNOWN {
        let sensor = known.sensor;
        for name in [sensor.to_owned(), sensor.to_lowercase(), sensor.replace('-', "_")] {
            assert_eq!(Datasheet::of(&name).map(|d| d.sensor), Some(sensor));
        }
        assert!(!known.document.is_empty());
        let nominal = known.sensitivities_lsb_per_g[0];
        assert_eq!(known.nominal(0.97 * nominal), Some(nominal));
        assert_eq!(known.nominal(1.5 * nominal), None);
    }
    assert!(Datasheet::of("MPU").is_none() && Datasheet::of("").is_none());
}

#[test]
fn each_parameter_stands_beside_its_limit_in_the_datasheets_unit() {
    // 60 mg on X, 4 % on Y, axes Y and Z 5 % from square.
    let truth = model(ErrorTerms {
        bias_mps2: [0.06 * G, 0.0, -0.02 * G],
        matrix: [[1.0, 0.0, 0.0], [0.0, 1.04, 0.0], [0.0, 0.05, 0.99]],
        ..ErrorTerms::default()
    });
    let mut random = Random::new(1);
    let mut poses: Vec<Pose> = twelve().map(|up| pose(&truth, G, up)).to_vec();
    poses.extend((0..8).map(|_| pose(&truth, G, random.direction())));
    for pose in &mut poses {
        pose.mean_mps2 = pose.mean_mps2.map(|y| y + 1e-3 * random.normal());
    }
    let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
    let datasheet = Datasheet::of("mpu6050").expect("known");
    let findings: Vec<_> = datasheet.findings(&estimate, Some(1.0), Some(2.0)).collect();
    assert_eq!(findings.len(), 9, "{findings:?}");
    let verdicts =
        |quantity| of(&findings, quantity).iter().map(Finding::verdict).collect::<Vec<_>>();
    use Verdict::{Beyond, Within};
    assert_eq!(verdicts(Quantity::ZeroGOffset), [Beyond, Within, Within]);
    assert_eq!(verdicts(Quantity::Sensitivity), [Within, Beyond, Within]);
    assert_eq!(verdicts(Quantity::CrossAxis), [Within, Within, Beyond]);
    let offset = of(&findings, Quantity::ZeroGOffset)[0];
    assert!((offset.value - 60.0).abs() < 1.0 && offset.limit.most == 50.0);
    assert!((of(&findings, Quantity::Sensitivity)[1].value - 4.0).abs() < 0.1);
    // An interval that reaches over the limit decides nothing.
    let unclear = Finding { half_width_95: 15.0, ..offset };
    assert_eq!(unclear.verdict(), Verdict::Unclear);
    // Of counts of unknown worth the scale factors say nothing.
    assert_eq!(datasheet.findings(&estimate, None, None).count(), 6);
}

#[test]
fn a_rotation_of_the_sensor_on_its_board_is_no_cross_axis_sensitivity() {
    let angle = 0.1_f64;
    let (s, c) = angle.sin_cos();
    let truth = model(ErrorTerms {
        matrix: [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
        ..ErrorTerms::default()
    });
    let poses = Face::ALL.map(|face| pose(&truth, G, Orientation::from(face).up()));
    let placement = Placement::new(0.001).expect("placement");
    let estimate = six_position(&poses, exact(), placement).expect("an answer");
    let datasheet = Datasheet::of("ADXL345").expect("known");
    let findings: Vec<_> = datasheet.findings(&estimate, Some(1.0), None).collect();
    for cross in of(&findings, Quantity::CrossAxis) {
        assert!(cross.value.abs() < 1e-9 && cross.verdict() == Verdict::Within, "{cross:?}");
    }
    // A turn about X says nothing of X.
    let turn: Vec<Pose> = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
        .map(|up| pose(&ErrorModel::default(), G, up))
        .to_vec();
    let estimate = four_angle(&turn, exact(), Placement::BY_HAND).expect("an answer");
    let subjects: Vec<_> =
        datasheet.findings(&estimate, Some(1.0), None).map(|f| f.subject).collect();
    assert_eq!(subjects, ["Y", "Z", "Y", "Z"]);
}

#[test]
fn temperature_and_nonlinearity_are_compared_where_they_were_fitted() {
    let mut terms = ErrorTerms::default();
    terms.temperature.bias_mps2_per_k = [0.02, 0.0, 0.0];
    terms.temperature.scale_per_k = [0.0, 5e-4, 0.0];
    // 1 % of ± 2 g from the best line.
    terms.nonlinearity = [0.0, 0.0, 0.01 / (0.5 * 2.0 * G)];
    let truth = model(terms);
    let mut random = Random::new(2);
    let poses: Vec<Pose> = (0..80)
        .map(|k| {
            let celsius = CentiCelsius(500 + 50 * k);
            let force = SpecificForceMps2(random.direction().map(|c| c * G));
            Pose {
                temperature_c: Some(celsius.to_celsius()),
                ..Pose::from_mean(
                    truth.distort(force, Some(celsius)).0.map(|y| y + 1e-4 * random.normal()),
                )
            }
        })
        .collect();
    let what = MultiPosition {
        terms: Terms::NONE
            .with(Term::BiasTemperature)
            .with(Term::ScaleTemperature)
            .with(Term::Quadratic),
        ..MultiPosition::default()
    };
    let estimate = multi_position(&poses, exact(), what).expect("an answer");
    let datasheet = Datasheet::of("MPU-9250").expect("known");
    let findings: Vec<_> = datasheet.findings(&estimate, Some(1.0), Some(2.0)).collect();
    let beyond: Vec<_> = findings
        .iter()
        .filter(|f| f.verdict() == Verdict::Beyond)
        .map(|f| (f.quantity, f.subject))
        .collect();
    assert_eq!(
        beyond,
        [
            (Quantity::OffsetPerKelvin, "X"),
            (Quantity::SensitivityPerKelvin, "Y"),
            (Quantity::Nonlinearity, "Z"),
        ]
    );
    let nonlinearity = of(&findings, Quantity::Nonlinearity)[2];
    assert!((nonlinearity.value - 1.0).abs() < 0.1, "{nonlinearity:?}");
    // Without the range nothing is said of full scale.
    assert_eq!(datasheet.findings(&estimate, None, None).count(), 3 + 3 + 3 + 3);
}
