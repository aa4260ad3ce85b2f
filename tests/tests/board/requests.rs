//! Parameters, settings and the memory that keeps them: refused with a reason, done once, kept.

use wimu_link::message::{EpochReason, Event, Payload, Refusal, Resolution, SetBytes, Settings};
use wimu_link::{Answer, Command, LinkRole, Request, WIRE_VERSION};
use wimu_model::{
    CompiledSet, ErrorModel, ErrorTerms, ParameterId, ParameterSet, Sensitivity, SetError,
    TemperatureTerms,
};
use wimu_node::Key;
use wimu_tests::{ROLES, Rig, assert_replays, compiled, encoded, frame_of, reply_frames};

const CABLE: LinkRole = LinkRole::Cable;

/// A calibration of these terms, compiled.
pub fn parameters(range_g: u8, lsb_per_g: f64, terms: ErrorTerms) -> SetBytes {
    compiled(&ParameterSet {
        model: ErrorModel::new(terms).unwrap(),
        ..ParameterSet::uncalibrated(range_g, Sensitivity::from_lsb_per_g(lsb_per_g).unwrap())
    })
}

pub fn usual_parameters(bias: f64) -> SetBytes {
    of_range(bias, 2)
}

fn of_range(bias: f64, range_g: u8) -> SetBytes {
    let terms = ErrorTerms {
        bias_mps2: [bias, -bias, bias / 2.0],
        matrix: [[1.02, 0.0, 0.0], [0.01, 0.98, 0.0], [-0.02, 0.005, 1.01]],
        temperature: TemperatureTerms::default(),
        nonlinearity: [0.0; 3],
    };
    parameters(range_g, 16384.0, terms)
}

pub fn push(rig: &mut Rig, set: &SetBytes) {
    let answer = rig.ask(CABLE, Command::SetParameters(*set));
    assert_eq!(answer, Answer::Accepted(Payload::None));
    assert_eq!(active(rig).0, *set);
}

/// The parameters in use and the id of their source.
pub fn active(rig: &mut Rig) -> (SetBytes, u32) {
    let answer = rig.ask(CABLE, Command::GetParameters);
    let Answer::Accepted(Payload::Parameters(bytes)) = answer else {
        panic!("{answer:?}");
    };
    (bytes, bytes.set().expect("a set").map_or(0, |set| set.source().0))
}

const UNCALIBRATED: (SetBytes, u32) = (SetBytes::NONE, 0);

fn newest_epoch_id(rig: &Rig) -> u32 {
    let epochs = rig.boot(CABLE).epochs();
    epochs[epochs.len() - 1].epoch.parameters
}

#[test]
fn parameters_that_are_none_are_refused_with_what_is_wrong_and_change_nothing() {
    let mut rig = Rig::usual();
    rig.run(2.0);
    let good = usual_parameters(0.5);
    let source = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap());
    let others = CompiledSet::compile(&source, ParameterId(1), 0xDEAD).unwrap();
    let damaged = |at: usize, by: u8| {
        let mut bytes = good.as_bytes().to_vec();
        bytes[at] ^= by;
        SetBytes::new(&bytes).unwrap()
    };
    let cut = SetBytes::new(&good.as_bytes()[..3]).unwrap();
    for (set, fault) in [
        (SetBytes::NONE, SetError::Length),
        (cut, SetError::Length),
        (damaged(30, 1), SetError::Checksum),
        (damaged(good.as_bytes().len() - 1, 0x80), SetError::Checksum),
        (SetBytes::from(&others), SetError::Device),
    ] {
        let answer = rig.ask(CABLE, Command::SetParameters(set));
        let refusal = Answer::Refused(Refusal::InvalidParameters(fault));
        assert_eq!(answer, refusal, "{set:?}");
    }
    let answer = rig.ask(CABLE, Command::SetParameters(of_range(0.5, 4)));
    let wrong_range = Refusal::WrongRange { parameters_g: 4, device_g: 2 };
    assert_eq!(answer, Answer::Refused(wrong_range));
    assert_eq!(active(&mut rig), UNCALIBRATED);
    for role in ROLES {
        rig.link(role).assert_perfect();
    }
    push(&mut rig, &good);
}

#[test]
fn the_wireless_link_reads_but_does_not_write_without_a_key() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    for write in [
        Command::SetParameters(usual_parameters(0.5)),
        Command::SetSettings(Settings::default()),
        Command::FactoryReset,
    ] {
        let answer = rig.ask(LinkRole::Wireless, write);
        assert_eq!(answer, Answer::Refused(Refusal::KeyNeeded), "{write:?}");
    }
    for read in [Command::GetParameters, Command::GetSettings, Command::GetStatus] {
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
    let faster = Settings { rate_hz: 200, ..Settings::default() };
    for (command, reason) in [
        (Command::SetParameters(usual_parameters(0.4)), EpochReason::Parameters),
        (Command::SetSettings(faster), EpochReason::Settings),
        (Command::FactoryReset, EpochReason::Settings),
    ] {
        let effects = |rig: &Rig| {
            let epochs = rig.boot(CABLE).epochs();
            let of = |reason| epochs.iter().filter(|m| m.epoch.reason == reason).count();
            of(reason)
        };
        let before = effects(&rig);
        let answers = insist(&mut rig, command);
        assert!(answers.len() >= 2, "{command:?}");
        assert!(answers.iter().all(|answer| *answer == answers[0]), "{command:?}: {answers:02x?}");
        assert_eq!(effects(&rig) - before, 1, "{command:?}");
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
    let epochs = rig.boot(LinkRole::Wireless).epochs();
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
        assert_eq!(active(&mut rig), (set, id));
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
        assert_eq!(active(&mut rig), UNCALIBRATED);
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
    let other = Command::SetParameters(usual_parameters(0.75));
    for write in
        [Command::SetSettings(Settings { rate_hz: 400, ..before }), other, Command::FactoryReset]
    {
        let answer = rig.ask(CABLE, write);
        assert_eq!(answer, Answer::Refused(Refusal::StoreFailed), "{write:?}");
        assert_eq!(rig.settings(), before, "{write:?}");
        assert_eq!(active(&mut rig), (set, id), "{write:?}");
        rig.run(2.0);
        assert_eq!(newest_epoch_id(&rig), id, "{write:?}");
        let epochs = rig.boot(CABLE).epochs();
        let period = epochs[epochs.len() - 1].epoch.period_ns;
        assert!(period.abs_diff(10_000_000) < 50_000, "{write:?}: {period}");
    }
    rig.board.storage().set_worn_out(false);
    push(&mut rig, &usual_parameters(0.75));
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
    assert!(rig.boot(CABLE).raw().len() > 250);
}

#[test]
fn a_damaged_record_is_told_and_the_board_runs_without_it() {
    let settings = Settings { rate_hz: 200, ..Settings::default() };
    let parameters = Key::Parameters { range_g: 2 };
    for key in [parameters, Key::Settings] {
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
        assert_eq!(active(&mut rig) != UNCALIBRATED, calibrated, "{key:?}");
        assert_eq!(newest_epoch_id(&rig) != 0, calibrated, "{key:?}");
        assert!(rig.boot(CABLE).raw().len() > 250, "{key:?}");
        for role in ROLES {
            assert_replays(rig.boot(role));
        }
        // Written again, it is whole again.
        rig.set(settings);
        push(&mut rig, &set);
        rig.restart();
        rig.run(1.0);
        assert_eq!(rig.settings(), settings, "{key:?}");
        assert_ne!(active(&mut rig), UNCALIBRATED, "{key:?}");
        assert_eq!(rig.link(CABLE).events(), [], "{key:?}");
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
            assert_eq!((rig.settings(), active(&mut rig)), (Settings::default(), UNCALIBRATED));
            assert_eq!(newest_epoch_id(&rig), 0);
        }
        Answer::Refused(Refusal::SensorFailed) => {
            assert_eq!((rig.settings(), active(&mut rig)), (before, held));
            assert_eq!(newest_epoch_id(&rig), held.1);
        }
        other => panic!("{other:?}"),
    }
}
