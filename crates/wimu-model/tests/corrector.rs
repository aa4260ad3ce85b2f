//! The corrector against the error model in f64.

use std::cell::Cell;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use wimu_model::{
    Alignment, CentiCelsius, CompileError, CompiledSet, Corrector, CorrectorParts, Counts,
    ErrorModel, ErrorTerms, ParameterId, ParameterSet, Sensitivity, SetError, SpecificForceMps2,
    TemperatureTerms, WideCounts,
};
use wimu_testkit::{figure, trials};

prop_compose! {
    fn terms()(
        bias in prop::array::uniform3(-5.0..5.0_f64),
        scale in prop::array::uniform3(0.8..1.2_f64),
        m in prop::array::uniform6(-0.1..0.1_f64),
        reference_c in -20.0..60.0_f64,
        b1 in prop::array::uniform3(-0.02..0.02_f64),
        b2 in prop::array::uniform3(-0.0005..0.0005_f64),
        s1 in prop::array::uniform3(-0.0005..0.0005_f64),
    ) -> ErrorTerms {
        ErrorTerms {
            bias_mps2: bias,
            matrix: [
                [scale[0], m[0], m[1]],
                [m[2], scale[1], m[3]],
                [m[4], m[5], scale[2]],
            ],
            temperature: TemperatureTerms {
                reference_c,
                bias_mps2_per_k: b1,
                bias_mps2_per_k2: b2,
                scale_per_k: s1,
            },
            nonlinearity: [0.0; 3],
        }
    }
}

prop_compose! {
    fn parameters()(
        terms in terms(),
        // 400 LSB/g to 65000 LSB/g, evenly in the logarithm.
        octave in 0.0..7.34_f64,
        quaternion in prop::array::uniform4(-1.0..1.0_f64)
            .prop_filter("a rotation", |q| Alignment::from_quaternion(*q).is_ok()),
    ) -> ParameterSet {
        ParameterSet {
            model: ErrorModel::new(terms).unwrap(),
            alignment: Alignment::from_quaternion(quaternion).unwrap(),
            ..ParameterSet::uncalibrated(
                2,
                Sensitivity::from_lsb_per_g(400.0 * octave.exp2()).unwrap(),
            )
        }
    }
}

/// Error of an axis, LSB, without 3 · 10⁻⁶ of the specific force: the rounding of the scale factor's slope.
fn beyond_slope(integer: i32, exact: [f64; 3], axis: usize) -> f64 {
    let off = (f64::from(integer) - exact[axis] * 65536.0).abs();
    off - 3e-6 * 65536.0 * SpecificForceMps2(exact).norm()
}

fn worst_lsb(parameters: &ParameterSet, at: CentiCelsius, counts: [i16; 3]) -> f64 {
    let corrector = Corrector::compile(parameters, Some(at)).unwrap();
    let integer = corrector.correct(Counts(counts)).0;
    let exact = parameters.correct(Counts(counts), Some(at)).0;
    (0..3).map(|axis| beyond_slope(integer[axis], exact, axis)).fold(0.0, f64::max)
}

fn cases() -> ProptestConfig {
    ProptestConfig::with_cases(trials(200_000) as u32)
}

#[test]
fn at_the_reference_is_within_1_lsb_of_f64_on_every_input() {
    let inputs = (parameters(), prop::array::uniform3(any::<i16>()));
    let largest = Cell::new(0.0_f64);
    let run = TestRunner::new(cases()).run(&inputs, |(mut parameters, counts)| {
        let at = CentiCelsius::from_celsius(parameters.model.terms().temperature.reference_c);
        let mut terms = *parameters.model.terms();
        terms.temperature.reference_c = at.to_celsius();
        parameters.model = ErrorModel::new(terms).unwrap();
        let corrector = Corrector::compile(&parameters, Some(at)).unwrap();
        let ends = counts.map(|c| if c < 0 { i16::MIN } else { i16::MAX });
        for counts in [counts, [i16::MIN; 3], [i16::MAX; 3], ends] {
            let integer = corrector.correct(Counts(counts)).0;
            let exact = parameters.correct(Counts(counts), Some(at)).0;
            for axis in 0..3 {
                let off = (f64::from(integer[axis]) - exact[axis] * 65536.0).abs();
                largest.set(largest.get().max(off));
                prop_assert!(off <= 1.0, "{off} LSB at {counts:?}");
            }
        }
        Ok(())
    });
    figure(
        "corrector in integers from f64, at the reference temperature, 2⁻¹⁶ m/s²",
        format!("{:.3}", largest.get()),
        "at most 1",
        run.is_ok(),
    );
    run.unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn is_within_2_lsb_of_f64_on_every_input() {
    let inputs = (parameters(), -1500_i16..7900, prop::array::uniform3(any::<i16>()));
    let largest = Cell::new(0.0_f64);
    let run = TestRunner::new(cases()).run(&inputs, |(parameters, at, counts)| {
        let ends = counts.map(|c| if c < 0 { i16::MIN } else { i16::MAX });
        for counts in [counts, [i16::MIN; 3], [i16::MAX; 3], ends] {
            let worst = worst_lsb(&parameters, CentiCelsius(at), counts);
            largest.set(largest.get().max(worst));
            prop_assert!(worst <= 2.0, "{worst} LSB at {counts:?}");
        }
        Ok(())
    });
    figure(
        "corrector in integers from f64 beyond 3 · 10⁻⁶ of the force, −15 to 79 °C, 2⁻¹⁶ m/s²",
        format!("{:.3}", largest.get()),
        "at most 2",
        run.is_ok(),
    );
    run.unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn wide_counts_are_within_2_lsb_of_f64_and_clamped_beyond_20_bits() {
    let inputs = (
        parameters().prop_map(|set| ParameterSet {
            sensitivity: Sensitivity::from_lsb_per_g(set.sensitivity.lsb_per_g().max(2000.0))
                .unwrap(),
            ..set
        }),
        -1500_i16..7900,
        prop::array::uniform3(WideCounts::MIN..=WideCounts::MAX),
    );
    let run = TestRunner::new(cases()).run(&inputs, |(parameters, at, counts)| {
        let at = Some(CentiCelsius(at));
        let corrector = Corrector::compile(&parameters, at).unwrap();
        let wide = |counts| corrector.correct_wide(WideCounts(counts));
        let edge = |beyond: i32| {
            counts.map(|c| if c < 0 { WideCounts::MIN - beyond } else { WideCounts::MAX + beyond })
        };
        for counts in
            [counts, edge(0), [WideCounts::MIN; 3], [WideCounts::MAX; 3], counts.map(|c| c >> 4)]
        {
            let scale = parameters.sensitivity.mps2_per_lsb();
            let output = SpecificForceMps2(counts.map(|c| f64::from(c) * scale));
            let exact = parameters.alignment.rotate(parameters.model.correct(output, at).0);
            for axis in 0..3 {
                let off = beyond_slope(wide(counts).0[axis], exact, axis);
                prop_assert!(off <= 2.0, "{off} LSB at {counts:?}");
            }
        }
        prop_assert_eq!(wide(edge(1)), wide(edge(0)));
        prop_assert_eq!(wide(edge(i32::MAX / 2)), wide(edge(0)));
        let narrow = counts.map(|c| c as i16);
        let same = wide(narrow.map(i32::from));
        prop_assert_eq!(same, corrector.correct(Counts(narrow)));
        Ok(())
    });
    run.unwrap_or_else(|error| panic!("{error}"));
}

#[test]
fn wide_counts_of_a_coarse_sensor_saturate_at_the_output_range() {
    let sensitivity = Sensitivity::from_lsb_per_g(160.0).unwrap();
    let parameters = ParameterSet::uncalibrated(2, sensitivity);
    let corrector = Corrector::compile(&parameters, None).unwrap();
    let force = corrector.correct_wide(WideCounts([i32::MIN, 0, i32::MAX]));
    assert_eq!(force.0, [-(1 << 29), 0, 1 << 29]);
}

#[test]
fn correcting_undoes_the_model() {
    let inputs = (terms(), prop::array::uniform3(-20.0..20.0_f64), -2000_i16..6000);
    let largest = Cell::new(0.0_f64);
    let run = TestRunner::new(cases()).run(&inputs, |(terms, force, at)| {
        let model = ErrorModel::new(terms).unwrap();
        let at = Some(CentiCelsius(at));
        let back = model.correct(model.distort(wimu_model::SpecificForceMps2(force), at), at);
        for axis in 0..3 {
            let off = (back.0[axis] - force[axis]).abs();
            largest.set(largest.get().max(off));
            prop_assert!(off < 1e-12, "{off}");
        }
        Ok(())
    });
    figure(
        "error model applied and corrected in f64, ± 20 m/s², m/s²",
        format!("{:.0e}", largest.get()),
        "below 1e-12",
        run.is_ok(),
    );
    run.unwrap_or_else(|error| panic!("{error}"));
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn no_numbers_whatever_make_it_panic(
        words in prop::collection::vec(any::<f64>(), 26), at in any::<Option<i16>>(), counts in prop::array::uniform3(any::<i16>())
    ) {
        let three = |i: usize| [words[i], words[i + 1], words[i + 2]];
        let terms = ErrorTerms {
            bias_mps2: three(0),
            matrix: [three(3), three(6), three(9)],
            temperature: TemperatureTerms {
                reference_c: words[12],
                bias_mps2_per_k: three(13),
                bias_mps2_per_k2: three(16),
                scale_per_k: three(19),
            },
            nonlinearity: three(22),
        };
        if let (Ok(model), Ok(sensitivity)) = (ErrorModel::new(terms), Sensitivity::from_lsb_per_g(words[25])) {
            let parameters = ParameterSet { model, ..ParameterSet::uncalibrated(2, sensitivity) };
            if let Ok(corrector) = Corrector::compile(&parameters, at.map(CentiCelsius)) {
                corrector.correct(Counts(counts));
            }
        }
    }
}

fn terms_with(change: impl FnOnce(&mut ErrorTerms)) -> Result<ErrorModel, String> {
    let mut terms = ErrorTerms::default();
    change(&mut terms);
    ErrorModel::new(terms).map_err(|error| error.to_string())
}

#[test]
fn a_model_out_of_bounds_is_refused_by_name() {
    let refused = |change: fn(&mut ErrorTerms)| terms_with(change).unwrap_err();
    assert_eq!(refused(|t| t.bias_mps2[1] = f64::NAN), "bias Y = NaN m/s² is outside -5 to 5 m/s²");
    assert_eq!(refused(|t| t.bias_mps2[2] = 9.8), "bias Z = 9.8 m/s² is outside -5 to 5 m/s²");
    assert_eq!(refused(|t| t.matrix[0][0] = -1.0), "scale factor X = -1 is outside 0.5 to 1.5");
    assert_eq!(
        refused(|t| t.matrix[0][2] = f64::INFINITY),
        "misalignment X = inf rad is outside -0.3 to 0.3 rad"
    );
    assert!(
        refused(|t| {
            t.matrix = [[0.5, 0.3, 0.3], [0.3, 0.5, -0.3], [0.3, -0.3, 0.5]];
        })
        .starts_with("the accelerometer's matrix cannot be inverted")
    );
}

#[test]
fn a_scale_factor_that_changes_too_much_with_temperature_is_refused() {
    let model = terms_with(|t| t.temperature.scale_per_k = [-0.01; 3]).unwrap();
    let parameters = ParameterSet {
        model,
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap())
    };
    assert_eq!(Corrector::compile(&parameters, None), Err(CompileError::Slope));
}

#[test]
fn full_scale_is_seen_at_both_ends_of_a_left_justified_12_bit_sensor() {
    assert!(Counts([0, 32752, 0]).saturated(32752));
    assert!(Counts([0, 0, -32768]).saturated(32752));
    assert!(Counts([0, -32752, 0]).saturated(32752));
    assert!(!Counts([32736, -32736, 0]).saturated(32752));
}

proptest! {
    #[test]
    fn the_integers_of_a_corrector_make_it_again(set in parameters()) {
        if let Ok(corrector) = Corrector::compile(&set, None) {
            prop_assert_eq!(Corrector::from_parts(corrector.to_parts()), Some(corrector));
        }
    }

    /// In tests an overflow panics.
    #[test]
    fn integers_that_would_overflow_are_refused(
        shift in 0..17_u8,
        coefficients in prop::array::uniform3(prop::array::uniform3(prop::num::i32::ANY)),
        offset in prop::array::uniform3(prop::num::i32::ANY),
        smaller in 0..31_u32,
        counts: [i16; 3],
    ) {
        let parts = CorrectorParts {
            shift,
            coefficients: coefficients.map(|row| row.map(|k| k >> smaller)),
            offset: offset.map(|o| o >> smaller),
        };
        if let Some(corrector) = Corrector::from_parts(parts) {
            prop_assert_eq!(corrector.to_parts(), parts);
            for counts in [counts, [i16::MIN; 3], [i16::MAX; 3]] {
                let force = corrector.correct(Counts(counts)).0;
                prop_assert!(force.iter().all(|f| f.unsigned_abs() <= (1 << 29) + (1 << 14)));
            }
        } else {
            prop_assert!(!(3..=14).contains(&shift) || smaller < 10);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(trials(20_000) as u32))]

    #[test]
    fn the_model_of_a_compiled_set_corrects_as_its_source(
        set in parameters(), change in -1000_i16..1000, counts in prop::array::uniform3(any::<i16>())
    ) {
        let compiled = CompiledSet::compile(&set, ParameterId(1), 0).unwrap();
        let Ok(again) = compiled.to_model(Some(set.sensitivity)) else { return Ok(()) };
        let reference = CentiCelsius::from_celsius(set.model.terms().temperature.reference_c);
        let at = Some(CentiCelsius(reference.0 + change));
        let [exact, found] = [&set, &again].map(|set| SpecificForceMps2(set.correct(Counts(counts), at).0));
        // Misalignments of 0.1 rad turn the scale factor's slope of 0.05 %/K, over 10 K.
        let bound = 3e-4 + f64::from(change.abs()) / 1000.0 * 1e-3 * exact.norm();
        for axis in 0..3 {
            let off = (found.0[axis] - exact.0[axis]).abs();
            prop_assert!(off < bound, "{off} m/s²");
        }
    }

    #[test]
    fn a_set_is_read_as_it_was_written_and_no_change_of_a_byte_goes_unnoticed(
        set in parameters(), place: prop::sample::Index, change in 1..=255_u8
    ) {
        let compiled = CompiledSet::compile(&set, ParameterId(0x1234_5678), 42).unwrap();
        let mut bytes = [0; CompiledSet::MAX_BYTES];
        let length = compiled.to_bytes(&mut bytes);
        prop_assert_eq!(CompiledSet::from_bytes(&bytes[..length]), Ok(compiled));
        for short in 0..length {
            prop_assert!(CompiledSet::from_bytes(&bytes[..short]).is_err());
        }
        bytes[place.index(length)] ^= change;
        prop_assert_eq!(CompiledSet::from_bytes(&bytes[..length]), Err(SetError::Checksum));
    }
}

#[test]
fn an_ideal_sensor_is_that_of_an_uncalibrated_set() {
    for lsb_per_g in [160.0, 256.0, 1024.0, 4098.36, 16384.0, 1_048_576.0] {
        let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).unwrap();
        let compiled = Corrector::compile(&ParameterSet::uncalibrated(2, sensitivity), None);
        assert_eq!(Ok(Corrector::ideal(sensitivity)), compiled, "{lsb_per_g}");
    }
}
