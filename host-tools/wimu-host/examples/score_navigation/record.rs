//! The main scores as figures of a campaign: today's library against the filter with zero-velocity updates.

use wimu_testkit::figure;

use crate::methods::{WITH_GYROSCOPE, WITH_GYROSCOPE_SMOOTHED, WITHOUT_GYROSCOPE, ZUPT_FILTER};
use crate::report::{ArrayReport, MethodReport, RecordingReport, Report};

/// Records each pool, the arrays, and the count of values that are not finite.
pub fn record(report: &Report) {
    for pool in &report.pooled {
        let name = pool.name.trim_end_matches(", pooled");
        record_pool(name, pool);
    }
    if let Some(journeys) = &report.journeys {
        record_pool("simulated journeys", &journeys.all);
    }
    for array in &report.arrays {
        record_array(array);
    }
    figure(
        "scores of navigation: values that are not finite",
        report.non_finite,
        "none",
        report.non_finite == 0,
    );
}

fn record_pool(name: &str, pool: &RecordingReport) {
    let method = |name: &str| pool.methods.iter().find(|method| method.name == name);
    let ratio = |name: &str| method(name)?.ratio_to.get(ZUPT_FILTER);
    if let Some(windows) = ratio(WITH_GYROSCOPE).and_then(|ratio| ratio.windows) {
        figure(
            &format!("{name}: median error over ZUPT filter, 1 / 2 / 5 s"),
            windows.map(|value| format!("{value:.2}")).join(" / "),
            "at most 1",
            windows.iter().all(|value| *value <= 1.0),
        );
    }
    if let Some(ratio) = ratio(WITH_GYROSCOPE) {
        figure(
            &format!("{name}: whole run, RMS error over that of the ZUPT filter"),
            format!("{:.2}", ratio.rms),
            "at most 1",
            ratio.rms <= 1.0,
        );
    }
    for (kind, library) in [
        ("gyroscope", WITH_GYROSCOPE),
        ("gyroscope, smoothed", WITH_GYROSCOPE_SMOOTHED),
        ("no gyroscope", WITHOUT_GYROSCOPE),
    ] {
        if let Some(method) = method(library) {
            record_consistency(&format!("{name}, {kind}"), method);
        }
    }
    let log_score = |name: &str| Some(method(name)?.whole.as_ref()?.position.as_ref()?.log_score);
    if let Some((ours, plain)) = log_score(WITH_GYROSCOPE).zip(log_score(ZUPT_FILTER)) {
        figure(
            &format!("{name}: log score of position"),
            format!("{ours:.2}"),
            &format!("ZUPT filter: {plain:.2}"),
            ours >= plain,
        );
    }
}

fn record_consistency(name: &str, method: &MethodReport) {
    let Some(whole) = &method.whole else {
        return;
    };
    let Some(position) = &whole.position else {
        return;
    };
    let (below, median) = (100.0 * position.nees_below_95, position.nees_median);
    figure(
        &format!("{name}: position NEES < 7.81, median"),
        format!("{below:.0} %, {median:.2}"),
        "90–98 %, 1.5–3.5",
        (90.0..=98.0).contains(&below) && (1.5..=3.5).contains(&median),
    );
    figure(
        &format!("{name}: valid, its largest error"),
        format!("{:.0} %, {:.1} σ", 100.0 * whole.valid, position.worst_sigma),
        "at most 5 σ",
        position.worst_sigma <= 5.0,
    );
}

fn record_array(array: &ArrayReport) {
    let of = |name: &str| array.methods.iter().find(|method| method.name == name);
    if let Some((ours, zero)) = of("wimu_array_zupt_on").zip(of("zero_rate")) {
        figure(
            &format!("{}: angular rate over none, deg/s rms", array.name),
            format!("{:.0} / {:.0}", ours.rms_deg_s, zero.rms_deg_s),
            "below 150",
            ours.rms_deg_s < 150.0,
        );
    }
}
