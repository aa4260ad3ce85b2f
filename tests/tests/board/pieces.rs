//! Parameter sets in pieces: whatever comes in another order, from another host or from later firmware is
//! refused or harmless.

use wimu_link::hello::sensor;
use wimu_link::message::{
    ParameterFault, Payload, Piece, Refusal, WireGyroscope, WireParameters, parameter_id,
};
use wimu_link::{Answer, Command, LinkRole};
use wimu_model::{GyroscopeModel, GyroscopeParameters, ParameterSet};
use wimu_tests::Rig;

use super::requests::{active, push, usual_parameters};

const CABLE: LinkRole = LinkRole::Cable;
const PART: Answer = Answer::Accepted(Payload::None);

/// A set of three pieces.
fn long(bias: f64) -> WireParameters {
    let model = GyroscopeModel::default();
    let gyroscope = GyroscopeParameters::new(500, 0.0003, model, Some([0.01; 12])).unwrap();
    WireParameters {
        sensor: Some(sensor::LSM303AGR),
        gyroscope: Some(WireGyroscope::from(&gyroscope)),
        ..usual_parameters(bias)
    }
}

fn id(set: &WireParameters) -> u32 {
    parameter_id(&ParameterSet::try_from(set).unwrap()).0
}

fn wrong(received: u16) -> Answer {
    Answer::Refused(Refusal::WrongPiece { received })
}

fn piece(offset: u16, total: u16, content: &[u8]) -> Command {
    Command::StageParameters { offset, total, piece: Piece::new(content).unwrap() }
}

fn bytes(set: &WireParameters) -> Vec<u8> {
    let mut bytes = [0; WireParameters::MAX];
    let length = set.encode(&mut bytes).unwrap();
    bytes[..length].to_vec()
}

fn rig() -> Rig {
    let mut rig = Rig::usual();
    rig.run(1.0);
    rig
}

#[test]
fn a_piece_that_does_not_continue_the_others_is_refused_and_changes_nothing() {
    let mut rig = rig();
    let set = long(0.5);
    let whole = bytes(&set);
    let total = whole.len() as u16;
    let mut ask = |command| rig.ask(CABLE, command);
    // Nothing has come, or not the one before.
    assert_eq!(ask(piece(256, total, &whole[256..512])), wrong(0));
    assert_eq!(ask(piece(0, total, &whole[..256])), PART);
    for (offset, total, content) in [
        (512, total, &whole[512..]),
        // A gap, an overlap with other content, an end beyond the whole.
        (257, total, &whole[257..300]),
        (255, total, &whole[..256]),
        (256, 400, &whole[256..512]),
        (256, total, &[]),
    ] {
        let received = if total == 400 { 0 } else { 256 };
        assert_eq!(ask(piece(offset, total, content)), wrong(received), "{offset}");
    }
    assert_eq!(ask(piece(0, 100, &whole[..101])), wrong(0));
    // Nothing of this is staged.
    let commit = Command::CommitParameters { hash: id(&set) };
    assert_eq!(ask(commit), Answer::Refused(Refusal::NothingStaged));
    push(&mut rig, &set);
}

#[test]
fn a_repeated_piece_is_harmless_and_the_set_applies_once() {
    let mut rig = rig();
    let set = long(0.5);
    let staged = Answer::Accepted(Payload::Staged { hash: id(&set) });
    let answers = |rig: &mut Rig, command| [(); 3].map(|()| rig.ask(CABLE, command));
    let commands: Vec<_> = set.stage().collect();
    let [first, second, last] = commands[..] else {
        panic!("{commands:?}");
    };
    // Each under a new number: its reply was lost with the session.
    assert_eq!(answers(&mut rig, first), [PART; 3]);
    assert_eq!(answers(&mut rig, second), [PART; 3]);
    assert_eq!(answers(&mut rig, last), [staged; 3]);
    assert_eq!(answers(&mut rig, second), [staged; 3]);
    assert_eq!(active(&mut rig), (None, 0));
    let commit = Command::CommitParameters { hash: id(&set) };
    assert_eq!(answers(&mut rig, commit), [PART; 3]);
    assert_eq!(active(&mut rig), (Some(set), id(&set)));
    let epochs = &rig.boot(CABLE).epochs;
    let changes = epochs.windows(2);
    let changes = changes.filter(|two| two[0].epoch.parameters != two[1].epoch.parameters);
    assert_eq!(changes.count(), 1);
}

#[test]
fn pieces_of_two_hosts_do_not_become_a_set_that_either_commits() {
    let mut rig = rig();
    let [ours, theirs] = [long(0.5), long(0.4)];
    let [our_pieces, their_pieces] = [ours, theirs].map(|set| set.stage().collect::<Vec<_>>());
    assert_eq!(rig.ask(CABLE, our_pieces[0]), PART);
    assert_eq!(rig.ask(CABLE, their_pieces[0]), PART);
    assert_eq!(rig.ask(CABLE, our_pieces[1]), PART);
    // All but the first piece are equal, so that this is the other host's set: ours is not.
    let staged = id(&theirs);
    let answer = rig.ask(CABLE, our_pieces[2]);
    assert_eq!(answer, Answer::Accepted(Payload::Staged { hash: staged }));
    let answer = rig.ask(CABLE, Command::CommitParameters { hash: id(&ours) });
    assert_eq!(answer, Answer::Refused(Refusal::HashMismatch { staged }));
    assert_eq!(active(&mut rig), (None, 0));
}

#[test]
fn pieces_are_forgotten_with_the_power() {
    let mut rig = rig();
    let set = long(0.5);
    let commands: Vec<_> = set.stage().collect();
    assert_eq!(rig.ask(CABLE, commands[0]), PART);
    rig.restart();
    rig.run(1.0);
    assert_eq!(rig.ask(CABLE, commands[1]), wrong(0));
    for command in &commands {
        rig.ask(CABLE, *command);
    }
    rig.restart();
    rig.run(1.0);
    let answer = rig.ask(CABLE, Command::CommitParameters { hash: id(&set) });
    assert_eq!(answer, Answer::Refused(Refusal::NothingStaged));
    assert_eq!(active(&mut rig), (None, 0));
}

#[test]
fn a_set_that_the_firmware_does_not_know_or_of_another_sensor_is_refused_with_the_reason() {
    let mut rig = rig();
    let refused = |fault| Answer::Refused(Refusal::InvalidParameters(fault));
    let newer = [bytes(&long(0.5)), vec![1; 9]].concat();
    let total = newer.len() as u16;
    let mut answer = Answer::Unknown;
    for (content, offset) in newer.chunks(Piece::MAX).zip([0, 256, 512]) {
        answer = rig.ask(CABLE, piece(offset, total, content));
    }
    assert_eq!(answer, refused(ParameterFault::Unknown { bytes: 9 }));
    let total = WireParameters::MAX as u16 + 20;
    let answer = rig.ask(CABLE, piece(0, total, &newer[..256]));
    assert_eq!(answer, refused(ParameterFault::Unknown { bytes: 20 }));
    let truncated = rig.ask(CABLE, piece(0, 100, &newer[..100]));
    assert_eq!(truncated, refused(ParameterFault::Unknown { bytes: 0 }));
    let others = WireParameters { sensor_index: 2, ..long(0.5) };
    let fault = ParameterFault::OtherSensorIndex { parameters: 2, device: 0 };
    assert_eq!(rig.stage(CABLE, &others), refused(fault));
    assert_eq!(active(&mut rig), (None, 0));
}
