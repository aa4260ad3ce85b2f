//! From any epoch the device's numbers are computed again bit for bit, whatever changes.

use wimu_link::LinkRole;
use wimu_link::message::{EpochReason, Resolution, Settings};
use wimu_sim::board::BoardConfig;
use wimu_sim::scene::{Temperature, World};
use wimu_tests::{ROLES, Rig, assert_replays, sensor};

fn reasons(rig: &Rig) -> Vec<EpochReason> {
    let epochs = rig.boot(LinkRole::Cable).epochs();
    epochs.iter().map(|mark| mark.epoch.reason).collect()
}

#[test]
fn a_change_of_range_rate_and_resolution_while_running_begins_an_epoch_and_replays() {
    let source = sensor("rest,hand,slide", World::default(), 11);
    let mut rig = Rig::new(BoardConfig::default(), source);
    rig.run(2.0);
    let changes = [
        (4, 100, Resolution::High),
        (4, 400, Resolution::Normal),
        (16, 50, Resolution::High),
        (8, 200, Resolution::LowPower),
        (2, 1344, Resolution::Normal),
        (2, 10, Resolution::High),
        (2, 100, Resolution::High),
    ];
    for (range_g, rate_hz, resolution) in changes {
        rig.set(Settings { range_g, rate_hz, resolution, ..Settings::default() });
        rig.run(3.0);
        for role in ROLES {
            let epochs = rig.boot(role).epochs();
            let last = &epochs[epochs.len() - 1].epoch;
            assert_eq!(last.range_g, range_g);
            let nominal = 1e9 / f64::from(rate_hz);
            assert!((f64::from(last.period_ns) / nominal - 1.0).abs() < 0.004);
        }
    }
    let changed = reasons(&rig).into_iter().filter(|reason| *reason == EpochReason::Settings);
    assert_eq!(changed.count(), changes.len());
    for role in ROLES {
        assert_replays(rig.boot(role));
        assert!(rig.boot(role).raw().len() > 4000);
    }
}

#[test]
fn a_step_of_temperature_begins_an_epoch_with_it_and_replays() {
    let world = World {
        temperature: Temperature::Step { before_c: 20.0, after_c: 31.0, at_s: 5.0 },
        ..World::default()
    };
    // A temperature dependence that shows: the parameters' own, pushed to the device.
    let source = sensor("rest,rest", world, 12);
    let model = source.truth.model;
    let offset_c = source.truth.thermometer_error_k;
    let mut rig = Rig::new(BoardConfig::default(), source);
    rig.run(1.0);
    super::requests::push(&mut rig, &super::requests::parameters(2, 16384.0, *model.terms()));
    rig.run(9.0);
    for role in ROLES {
        let boot = rig.boot(role);
        let stepped: Vec<f64> = boot
            .epochs()
            .iter()
            .filter(|mark| {
                mark.epoch.reason == EpochReason::Temperature && mark.epoch.time_us > 5_000_000
            })
            .filter_map(|mark| mark.epoch.temperature_centi_c)
            .map(|centi| f64::from(centi) / 100.0)
            .collect();
        assert_eq!(stepped.len(), 1, "{stepped:?}");
        assert!((stepped[0] - (31.0 + offset_c)).abs() < 1.0, "{stepped:?}");
        rig.link(role).assert_perfect();
    }
}

#[test]
fn epochs_come_at_least_once_a_second_and_both_links_get_every_one() {
    let source = sensor("rest,hand,slide", World::default(), 13);
    let mut rig = Rig::new(BoardConfig::default(), source);
    rig.run(25.0);
    let [cable, wireless] = ROLES.map(|role| {
        let epochs = rig.boot(role).epochs();
        epochs.iter().map(|mark| mark.epoch).collect::<Vec<_>>()
    });
    assert_eq!(cable, wireless);
    for pair in cable.windows(2) {
        assert!(pair[1].time_us - pair[0].time_us <= 1_000_000, "{pair:?}");
    }
    for role in ROLES {
        rig.link(role).assert_perfect();
    }
}

#[test]
fn a_recording_replays_as_the_live_link_does() {
    let mut rig = Rig::usual();
    rig.run(8.0);
    rig.restart();
    rig.run(4.0);
    let recording = rig.recording();
    assert_eq!(recording.links.len(), 2);
    for link in recording.links.values() {
        let starts = [1, 2].map(Some);
        let counted = [0, 1].map(|n| link.boots[n].hello.map(|hello| hello.boot_count));
        assert_eq!(counted, starts);
        for boot in &link.boots {
            assert_replays(boot);
        }
        assert_eq!(link.statistics, rig.link(link.role).record().statistics);
    }
}
