//! Parameters, settings and the memory that keeps them: refused with a reason, done once, kept.

use wimu_host::decode::Pieces;
use wimu_link::hello::sensor;
use wimu_link::message::{
    ActiveParameters, EpochReason, Event, ParameterFault, Payload, Refusal, Resolution, Settings,
    WireParameters, WireTerm,
};
use wimu_link::{Answer, Command, LinkRole, Request, WIRE_VERSION};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity, TemperatureTerms};
use wimu_node::Key;
use wimu_tests::{ROLES, Rig, assert_replays, encoded, frame_of, reply_frames, staging};

const CABLE: LinkRole = LinkRole::Cable;

/// A valid set of these terms.
pub fn parameters(range_g: u8, lsb_per_g: f64, terms: ErrorTerms) -> WireParameters {
    (&ParameterSet {
        model: ErrorModel::new(terms).unwrap(),
        ..ParameterSet::uncalibrated(range_g, Sensitivity::from_lsb_per_g(lsb_per_g).unwrap())
    })
        .into()
}

pub fn usual_parameters(bias: f64) -> WireParameters {
    let terms = ErrorTerms {
        bias_mps2: [bias, -bias, bias / 2.0],
        matrix: [[1.02, 0.0, 0.0], [0.01, 0.98, 0.0], [-0.02, 0.005, 1.01]],
        temperature: TemperatureTerms::default(),
        nonlinearity: [0.0; 3],
    };
    parameters(2, 16384.0, terms)
}

fn stage(rig: &mut Rig, set: &WireParameters) -> u32 {
    match rig.stage(CABLE, set) {
        Answer::Accepted(Payload::Staged { hash }) => hash,
        other => panic!("{other:?}"),
    }
}

/// Stages and commits.
pub fn push(rig: &mut Rig, set: &WireParameters) {
    let hash = stage(rig, set);
    let answer = rig.ask(CABLE, Command::CommitParameters { hash });
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    assert_eq!(active(rig), (Some(*set), hash));
}

/// The parameters in use and their id.
pub fn active(rig: &mut Rig) -> (Option<WireParameters>, u32) {
    let mut pieces = Pieces::default();
    loop {
        let offset = pieces.received();
        let answer = rig.ask(CABLE, Command::GetParameters { offset });
        let Answer::Accepted(Payload::Parameters(piece)) = answer else {
            panic!("{answer:?}");
        };
        if let Some(ActiveParameters { active, id }) = pieces.take(&piece).expect("a set") {
            return (active, id);
        }
    }
}

fn newest_epoch_id(rig: &Rig) -> u32 {
    let epochs = &rig.boot(CABLE).epochs;
    epochs[epochs.len() - 1].epoch.parameters
}

#[test]
fn parameters_that_are_none_are_refused_with_what_is_wrong_and_change_nothing() {
    let mut rig = Rig::usual();
    rig.run(2.0);
    let good = usual_parameters(0.5);
    let not_finite = |term, axis| ParameterFault::NotFinite { term, axis };
    let nan_bias = WireParameters { bias_mps2: [0.0, f64::NAN, 0.0], ..good };
    let infinite_scale = WireParameters {
        matrix: [[f64::INFINITY, 0.0, 0.0], good.matrix[1], good.matrix[2]],
        ..good
    };
    let nan_slope = WireParameters { bias_mps2_per_k: [0.0, 0.0, f64::NAN], ..good };
    let large_bias = WireParameters { bias_mps2: [0.0, 0.0, -5.5], ..good };
    let mirrored =
        WireParameters { matrix: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], ..good };
    let singular =
        WireParameters { matrix: [[0.5, 0.3, 0.3], [0.3, 0.5, -0.3], [0.3, -0.3, 0.5]], ..good };
    let no_rotation = WireParameters { alignment_wxyz: [0.0; 4], ..good };
    let insensitive = WireParameters { sensitivity_lsb_per_g: 0.0, ..good };
    let overflowing = WireParameters {
        sensitivity_lsb_per_g: 160.0,
        matrix: [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]],
        ..good
    };
    let singular_when_warm = WireParameters { reference_c: 150.0, scale_per_k: [0.01; 3], ..good };
    for (set, fault) in [
        (nan_bias, not_finite(WireTerm::Bias, 1)),
        (infinite_scale, not_finite(WireTerm::Scale, 0)),
        (nan_slope, not_finite(WireTerm::BiasSlope, 2)),
        (
            large_bias,
            ParameterFault::OutOfBounds {
                term: WireTerm::Bias,
                axis: 2,
                value: -5.5,
                low: -5.0,
                high: 5.0,
            },
        ),
        (
            mirrored,
            ParameterFault::OutOfBounds {
                term: WireTerm::Scale,
                axis: 1,
                value: -1.0,
                low: 0.5,
                high: 1.5,
            },
        ),
        (no_rotation, ParameterFault::Alignment(0.0)),
        (insensitive, ParameterFault::Sensitivity(0.0)),
        (overflowing, ParameterFault::Overflow),
        (singular_when_warm, ParameterFault::SingularAtTemperature),
    ] {
        let answer = rig.stage(CABLE, &set);
        let refusal = Answer::Refused(Refusal::InvalidParameters(fault));
        assert_eq!(answer, refusal, "{set:?}");
    }
    let answer = rig.stage(CABLE, &singular);
    assert!(
        matches!(
            answer,
            Answer::Refused(Refusal::InvalidParameters(ParameterFault::Singular(d))) if d < 0.05
        ),
        "{answer:?}"
    );
    let answer = rig.stage(CABLE, &WireParameters { range_g: 4, ..good });
    let wrong_range = Refusal::WrongRange { parameters_g: 4, device_g: 2 };
    assert_eq!(answer, Answer::Refused(wrong_range));
    let eightfold = WireParameters { sensitivity_lsb_per_g: 2048.0, ..good };
    let answer = rig.stage(CABLE, &eightfold);
    let wrong_sensitivity =
        Refusal::WrongSensitivity { parameters_lsb_per_g: 2048.0, device_lsb_per_g: 16384.0 };
    assert_eq!(answer, Answer::Refused(wrong_sensitivity));
    let others = WireParameters { sensor: Some(sensor::ADXL345), ..good };
    let answer = rig.stage(CABLE, &others);
    let fault =
        ParameterFault::OtherSensor { parameters: sensor::ADXL345, device: sensor::LSM303AGR };
    assert_eq!(answer, Answer::Refused(Refusal::InvalidParameters(fault)));
    // Nothing of this was staged.
    let answer = rig.ask(CABLE, Command::CommitParameters { hash: 1 });
    assert_eq!(answer, Answer::Refused(Refusal::NothingStaged));
    assert_eq!(active(&mut rig), (None, 0));
    for role in ROLES {
        rig.link(role).assert_perfect();
    }
    // Its own sensor's are taken, and so are those that do not say whose they are.
    for sensor in [None, Some(sensor::LSM303AGR)] {
        stage(&mut rig, &WireParameters { sensor, ..good });
    }
}

#[test]
fn a_commit_names_what_was_staged_or_is_refused() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let staged = stage(&mut rig, &usual_parameters(0.5));
    let answer = rig.ask(CABLE, Command::CommitParameters { hash: !staged });
    assert_eq!(answer, Answer::Refused(Refusal::HashMismatch { staged }));
    assert_eq!(active(&mut rig), (None, 0));
    let answer = rig.ask(CABLE, Command::CommitParameters { hash: staged });
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    assert_eq!(active(&mut rig).1, staged);
}

#[test]
fn the_wireless_link_reads_but_does_not_write_without_a_key() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    for write in [
        staging(&usual_parameters(0.5)),
        Command::CommitParameters { hash: 1 },
        Command::SetSettings(Settings::default()),
        Command::FactoryReset,
    ] {
        let answer = rig.ask(LinkRole::Wireless, write);
        assert_eq!(answer, Answer::Refused(Refusal::KeyNeeded), "{write:?}");
    }
    for read in [Command::GetParameters { offset: 0 }, Command::GetSettings, Command::GetStatus] {
        let answer = rig.ask(LinkRole::Wireless, read);
        assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    }
}

/// Sends a request three times, twice of it in one breath, with all answers but the last lost:
/// returns the answers' frames.
fn insist(rig: &mut Rig, command: Command) -> Vec<Vec<u8>> {
    let known = reply_frames(&rig.link(CABLE).bytes()).len();
    let frame = rig.frame_of(command);
    rig.send(CABLE, &[frame.clone(), frame.clone()].concat());
    rig.run(1.0);
    rig.send(CABLE, &frame);
    rig.run(1.0);
    reply_frames(&rig.link(CABLE).bytes()).split_off(known)
}

#[test]
fn a_request_that_is_repeated_has_one_effect_and_the_same_answer() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let hash = stage(&mut rig, &usual_parameters(0.4));
    let faster = Settings { rate_hz: 200, ..Settings::default() };
    for (command, reason) in [
        (Command::CommitParameters { hash }, EpochReason::Parameters),
        (Command::SetSettings(faster), EpochReason::Settings),
        (Command::FactoryReset, EpochReason::Settings),
        (staging(&usual_parameters(0.3)), EpochReason::Start),
    ] {
        let effects = |rig: &Rig| {
            let epochs = &rig.boot(CABLE).epochs;
            let of = |reason| epochs.iter().filter(|m| m.epoch.reason == reason).count();
            of(reason)
        };
        let before = effects(&rig);
        let answers = insist(&mut rig, command);
        assert!(answers.len() >= 2, "{command:?}");
        assert!(answers.iter().all(|answer| *answer == answers[0]), "{command:?}: {answers:02x?}");
        let expected = usize::from(reason != EpochReason::Start);
        assert_eq!(effects(&rig) - before, expected, "{command:?}");
    }
    assert_eq!(rig.settings(), Settings::default());
    assert_replays(rig.boot(CABLE));
}

#[test]
fn an_answer_that_was_lost_is_given_again_and_the_set_is_not_applied_twice() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let slower = Settings { rate_hz: 50, ..Settings::default() };
    let frame = rig.frame_of(Command::SetSettings(slower));
    rig.send(CABLE, &frame);
    // What the cable brings in this second reaches nobody.
    rig.listen(CABLE, false);
    rig.run(1.0);
    let lost = rig.board.link(CABLE).pull();
    rig.listen(CABLE, true);
    let answers = rig.link(CABLE).replies().len();
    rig.send(CABLE, &frame);
    rig.run(1.0);
    let replies = &rig.link(CABLE).replies()[answers..];
    assert_eq!(replies.len(), 1);
    assert_eq!(replies[0].answer, Answer::Accepted(Payload::Settings(slower)));
    let again = reply_frames(&rig.link(CABLE).bytes());
    assert_eq!(reply_frames(&lost), again[again.len() - 1..]);
    assert_eq!(times_set(&rig), 1);
}

/// How often the settings were changed. The wireless link hears of every change.
fn times_set(rig: &Rig) -> usize {
    let epochs = &rig.boot(LinkRole::Wireless).epochs;
    let set = epochs.iter().filter(|mark| mark.epoch.reason == EpochReason::Settings);
    set.count()
}

#[test]
fn a_late_repeat_does_not_undo_what_another_host_has_set_since() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let set = |session, rate_hz| {
        let request = Request {
            session,
            id: 1,
            signature: Default::default(),
            command: Command::SetSettings(Settings { rate_hz, ..Settings::default() }),
        };
        encoded(|frame| request.encode(frame))
    };
    for frame in [set(1, 50), set(2, 400), set(1, 50)] {
        rig.send(CABLE, &frame);
        rig.run(1.0);
    }
    let last = rig.link(CABLE).replies().last().expect("an answer");
    assert_eq!((last.session, last.answer), (1, Answer::Refused(Refusal::Stale)));
    assert_eq!(times_set(&rig), 2);
    assert_eq!(rig.settings().rate_hz, 400);
}

#[test]
fn an_unknown_command_is_answered_as_unknown() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    // Session 9, id 1, no signature, command 77.
    rig.send(CABLE, &frame_of(WIRE_VERSION, 5, &[9, 1, 0, 77, 1, 2, 3]));
    rig.run(0.5);
    let replies = rig.link(CABLE).replies();
    let last = replies.last().expect("an answer");
    assert_eq!((last.session, last.id, last.answer), (9, 1, Answer::Unknown));
}

#[test]
fn settings_that_the_sensor_cannot_do_are_refused_with_the_nearest() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let now = rig.settings();
    let nearest_to = |wanted: Settings, nearest: Settings, rig: &mut Rig| {
        let answer = rig.ask(CABLE, Command::SetSettings(wanted));
        let refusal = Refusal::UnsupportedSettings { nearest };
        assert_eq!(answer, Answer::Refused(refusal), "{wanted:?}");
        // The nearest is one that it can do.
        rig.set(nearest);
        rig.set(now);
    };
    let with = |change: fn(&mut Settings)| {
        let mut settings = now;
        change(&mut settings);
        settings
    };
    for (wanted, nearest) in [
        (with(|s| s.range_g = 3), with(|s| s.range_g = 2)),
        (with(|s| s.range_g = 0), with(|s| s.range_g = 2)),
        (with(|s| s.range_g = 255), with(|s| s.range_g = 16)),
        (with(|s| s.rate_hz = 0), with(|s| s.rate_hz = 1)),
        (with(|s| s.rate_hz = 333), with(|s| s.rate_hz = 400)),
        (with(|s| s.rate_hz = 65535), with(|s| s.rate_hz = 1344)),
        (with(|s| s.cable.batch = 0), with(|s| s.cable.batch = 1)),
        (with(|s| s.wireless.batch = 200), with(|s| s.wireless.batch = 32)),
        (with(|s| s.gravity_um_s2 = 0), with(|s| s.gravity_um_s2 = 9_700_000)),
        (
            with(|s| {
                s.rate_hz = 1344;
                s.resolution = Resolution::LowPower;
            }),
            with(|s| {
                s.rate_hz = 400;
                s.resolution = Resolution::LowPower;
            }),
        ),
    ] {
        nearest_to(wanted, nearest, &mut rig);
    }
    assert_eq!(rig.settings(), now);
}

#[test]
fn settings_and_parameters_survive_a_restart() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let settings =
        Settings { rate_hz: 200, zupt: false, gravity_um_s2: 9_812_345, ..Settings::default() };
    rig.set(settings);
    let set = usual_parameters(0.25);
    push(&mut rig, &set);
    let id = active(&mut rig).1;
    for start in 2..4 {
        rig.restart();
        rig.run(3.0);
        assert_eq!(rig.settings(), settings);
        assert_eq!(active(&mut rig), (Some(set), id));
        assert_eq!(newest_epoch_id(&rig), id);
        let hello = rig.boot(CABLE).hello.unwrap();
        assert_eq!((hello.boot_count, hello.parameter_id.0), (start, id));
        assert_replays(rig.boot(CABLE));
    }
    let answer = rig.ask(CABLE, Command::FactoryReset);
    assert_eq!(answer, Answer::Accepted(Payload::None));
    for restart in [false, true] {
        if restart {
            rig.restart();
            rig.run(2.0);
        }
        assert_eq!(rig.settings(), Settings::default());
        assert_eq!(active(&mut rig), (None, 0));
        rig.run(1.0);
        assert_eq!(newest_epoch_id(&rig), 0);
    }
}

#[test]
fn parameters_of_another_range_rest_until_the_range_is_theirs_again() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let set = usual_parameters(0.25);
    push(&mut rig, &set);
    let id = active(&mut rig).1;
    rig.set(Settings { range_g: 8, ..Settings::default() });
    rig.run(2.0);
    assert_eq!(newest_epoch_id(&rig), 0);
    rig.set(Settings::default());
    rig.run(2.0);
    assert_eq!(newest_epoch_id(&rig), id);
    assert_replays(rig.boot(CABLE));
}

#[test]
fn a_worn_out_memory_refuses_writes_and_everything_stays_as_it_was() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let set = usual_parameters(0.25);
    push(&mut rig, &set);
    let id = active(&mut rig).1;
    let before = rig.settings();
    rig.board.storage().set_worn_out(true);
    let hash = stage(&mut rig, &usual_parameters(0.75));
    for write in [
        Command::SetSettings(Settings { rate_hz: 400, ..before }),
        Command::CommitParameters { hash },
        Command::FactoryReset,
    ] {
        let answer = rig.ask(CABLE, write);
        assert_eq!(answer, Answer::Refused(Refusal::StoreFailed), "{write:?}");
        assert_eq!(rig.settings(), before, "{write:?}");
        assert_eq!(active(&mut rig), (Some(set), id), "{write:?}");
        rig.run(2.0);
        assert_eq!(newest_epoch_id(&rig), id, "{write:?}");
        let epochs = &rig.boot(CABLE).epochs;
        let period = epochs[epochs.len() - 1].epoch.period_ns;
        assert!(period.abs_diff(10_000_000) < 50_000, "{write:?}: {period}");
    }
    // What was staged is still there when the memory is.
    rig.board.storage().set_worn_out(false);
    let answer = rig.ask(CABLE, Command::CommitParameters { hash });
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    assert_eq!(active(&mut rig).1, hash);
    assert_replays(rig.boot(CABLE));
}

#[test]
fn a_board_with_a_worn_out_memory_starts_and_says_so() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    push(&mut rig, &usual_parameters(0.25));
    let held = active(&mut rig);
    rig.board.storage().set_worn_out(true);
    rig.restart();
    rig.run(3.0);
    assert_eq!(rig.link(CABLE).events(), [Event::StoreUnreadable]);
    assert_eq!(active(&mut rig), held);
    assert!(rig.boot(CABLE).raw.len() > 250);
}

#[test]
fn a_damaged_record_is_told_and_the_board_runs_without_it() {
    let settings = Settings { rate_hz: 200, ..Settings::default() };
    let parameters = Key::Parameters { range_g: 2 };
    for key in [parameters, Key::Settings, Key::BootCount] {
        let mut rig = Rig::usual();
        rig.run(1.0);
        rig.set(settings);
        let set = usual_parameters(0.25);
        push(&mut rig, &set);
        rig.board.storage().corrupt(key);
        rig.restart();
        rig.run(3.0);
        assert_eq!(rig.link(CABLE).events(), [Event::StoreUnreadable], "{key:?}");
        let expected = match key {
            Key::Settings => Settings::default(),
            _ => settings,
        };
        assert_eq!(rig.settings(), expected, "{key:?}");
        let calibrated = key != parameters;
        assert_eq!(active(&mut rig).0.is_some(), calibrated, "{key:?}");
        assert_eq!(newest_epoch_id(&rig) != 0, calibrated, "{key:?}");
        assert!(rig.boot(CABLE).raw.len() > 250, "{key:?}");
        for role in ROLES {
            assert_replays(rig.boot(role));
        }
        // Written again, it is whole again.
        rig.set(settings);
        push(&mut rig, &set);
        rig.restart();
        rig.run(1.0);
        assert_eq!(rig.settings(), settings, "{key:?}");
        assert!(active(&mut rig).0.is_some(), "{key:?}");
        if key != Key::BootCount {
            assert_eq!(rig.link(CABLE).events(), [], "{key:?}");
        }
    }
}

#[test]
fn a_factory_reset_without_a_sensor_does_all_or_nothing() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let set = usual_parameters(0.25);
    push(&mut rig, &set);
    rig.set(Settings { rate_hz: 200, ..Settings::default() });
    let (before, held) = (rig.settings(), active(&mut rig));
    rig.board.sensor().set_present(false);
    rig.run(0.5);
    let answer = rig.ask(CABLE, Command::FactoryReset);
    rig.board.sensor().set_present(true);
    rig.run(2.0);
    match answer {
        Answer::Accepted(_) => {
            assert_eq!((rig.settings(), active(&mut rig)), (Settings::default(), (None, 0)));
            assert_eq!(newest_epoch_id(&rig), 0);
        }
        Answer::Refused(Refusal::SensorFailed) => {
            assert_eq!((rig.settings(), active(&mut rig)), (before, held));
            assert_eq!(newest_epoch_id(&rig), held.1);
        }
        other => panic!("{other:?}"),
    }
}
