//! A unit on a foot: public recordings with optical truth.

use std::path::Path;

use wimu_host::imu::Imu;
use wimu_host::inertial::{Choice, Profile, navigate};
use wimu_testkit::Lane;

fn on_foot() -> Choice {
    Choice { profile: Profile::Foot, ..Choice::default() }
}

fn trial(name: &str) -> Option<Imu> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/gait");
    let csv = folder.join(format!("pyshoe_{name}.csv"));
    if !csv.exists() {
        println!("skipped: the public recordings, ../shared/data, are absent");
        return None;
    }
    Some(crate::common::read(&csv).unwrap())
}

/// A fixed threshold ends 30 m and 5 m off.
#[test]
fn one_setting_follows_a_run_and_a_slow_walk() {
    let trials = [("2017-12-15-18-03-05", 0.5), ("2018-02-09-11-22-01", 1.3)];
    for (name, limit_m) in trials.into_iter().take(Lane::current().choose([0, 1, 2])) {
        let Some(recording) = trial(name) else {
            return;
        };
        let path = navigate(&recording, &on_foot()).unwrap();
        let truth = &recording.reference.position_m.v;
        let (first, last) = (truth[0].into(), truth[truth.len() - 1].into());
        let [start, end] = [&path.points[0], &path.points[path.points.len() - 1]];
        let way = |a: [f64; 3], b: [f64; 3]| [(b[0] - a[0]).hypot(b[1] - a[1]), b[2] - a[2]];
        let found = way(start.position_m, end.position_m);
        let walked = way(first, last);
        for (what, k) in [("horizontal", 0), ("up", 1)] {
            let off = (found[k] - walked[k]).abs();
            println!("{name}: {what}: {:.2} m of {:.2} m", found[k], walked[k]);
            assert!(off < limit_m, "{name}: {what}: {off}");
            assert!(off < 3.0 * end.sd_m(), "{name}: {what}: {off}");
        }
    }
}

#[test]
fn a_foot_without_a_gyroscope_is_refused() {
    let Some(mut recording) = trial("2018-02-22-10-10-56") else {
        return;
    };
    for sample in &mut recording.samples.v {
        sample.rate_rad_s = None;
    }
    let refused = navigate(&recording, &on_foot()).unwrap_err();
    assert!(refused.to_string().contains("needs a gyroscope"), "{refused}");
}
