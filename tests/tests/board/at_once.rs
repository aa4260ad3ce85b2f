//! Two hosts that push at the same moment, one on each link.

use std::time::Duration;

use wimu_link::auth::{DeviceKey, Session};
use wimu_link::message::{ParametersPiece, Payload, WireParameters, parameter_id};
use wimu_link::requester::Next;
use wimu_link::{Answer, Command, Deframer, Kind, LinkRole, Requester};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::scene::World;
use wimu_tests::{ROLES, sensor, staging};

const KEY: DeviceKey = DeviceKey::new([0x11; 32]);
/// How often the hosts look at their links, µs.
const STEP_US: u64 = 250;

/// A host that does not block, so that two of them run at once.
struct Host {
    role: LinkRole,
    requester: Requester,
    deframer: Deframer,
}

impl Host {
    fn new(role: LinkRole, session: u32) -> Self {
        Self { role, requester: Requester::new(session), deframer: Deframer::new() }
    }

    fn ask(&mut self, board: &mut Board, command: Command) {
        let now = Duration::from_micros(board.now_us());
        board.link(self.role).push(self.requester.start(command, now));
    }

    fn look(&mut self, board: &mut Board) -> Option<Answer> {
        let mut answer = None;
        for byte in board.link(self.role).pull() {
            if let Some(Ok(frame)) = self.deframer.push(byte)
                && frame.kind == Kind::Reply
            {
                answer = self.requester.on_reply(frame.body).or(answer);
            }
        }
        if let Next::Send(frame) = self.requester.poll(Duration::from_micros(board.now_us())) {
            board.link(self.role).push(frame);
        }
        answer
    }

    /// Asks and waits.
    fn answer(&mut self, board: &mut Board, command: Command) -> Answer {
        self.ask(board, command);
        for _ in 0..20_000 {
            step(board);
            if let Some(answer) = self.look(board) {
                return answer;
            }
        }
        panic!("no answer to {command:?}");
    }

    fn sign(&mut self, board: &mut Board, device_id: u64) {
        match self.answer(board, Command::OpenSession) {
            Answer::Accepted(Payload::Session { number, nonce }) => {
                let session = Session { key: KEY, role: self.role, device_id, number, nonce };
                self.requester.sign(session, 1);
            }
            other => panic!("{other:?}"),
        }
    }
}

fn step(board: &mut Board) {
    let later = board.now_us() + STEP_US;
    board.run_until(later);
}

/// A push under way.
enum Push {
    /// It begins then, µs.
    At(u64),
    Staging,
    Committing,
    /// It ended: committed, or refused.
    Ended(bool),
}

#[test]
fn of_two_pushes_at_once_one_gets_through_and_both_are_told_the_truth() {
    let config = BoardConfig::default();
    let device_id = config.device_id;
    let mut board = Board::start(config, sensor("rest", World::default(), 3));
    let mut hosts = [Host::new(LinkRole::Cable, 1), Host::new(LinkRole::Wireless, 2)];
    let answer = hosts[0].answer(&mut board, Command::SetKey(KEY));
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    for host in &mut hosts {
        host.sign(&mut board, device_id);
    }
    let mut committed = [0; 2];
    let mut bias = 0.0;
    // From one long before the other to the other way round, through all that is in between.
    for offset in -120_i64..=120 {
        let sets: [ParameterSet; 2] = ROLES.map(|_| {
            bias += 1e-4;
            let terms = ErrorTerms { bias_mps2: [bias, 0.0, 0.0], ..ErrorTerms::default() };
            ParameterSet {
                model: ErrorModel::new(terms).expect("a model"),
                ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).expect("its"))
            }
        });
        let wires = sets.each_ref().map(WireParameters::from);
        let ids = sets.each_ref().map(|set| parameter_id(set).0);
        let begin = board.now_us();
        let late = offset.unsigned_abs() * STEP_US;
        let mut pushes = match offset < 0 {
            true => [Push::At(begin + late), Push::At(begin)],
            false => [Push::At(begin), Push::At(begin + late)],
        };
        let mut last = None;
        while !pushes.iter().all(|push| matches!(push, Push::Ended(_))) {
            assert!(board.now_us() < begin + 5_000_000, "offset {offset}");
            step(&mut board);
            for (which, (host, push)) in hosts.iter_mut().zip(&mut pushes).enumerate() {
                let answer = host.look(&mut board);
                *push = match (&*push, answer) {
                    (Push::At(at), _) if board.now_us() >= *at => {
                        host.ask(&mut board, staging(&wires[which]));
                        Push::Staging
                    }
                    (Push::Staging, Some(Answer::Accepted(Payload::Staged { hash }))) => {
                        assert_eq!(hash, ids[which]);
                        host.ask(&mut board, Command::CommitParameters { hash });
                        Push::Committing
                    }
                    (Push::Committing, Some(Answer::Accepted(_))) => {
                        last = Some(which);
                        committed[which] += 1;
                        Push::Ended(true)
                    }
                    (_, Some(Answer::Refused(_))) => Push::Ended(false),
                    (_, Some(other)) => panic!("{other:?}"),
                    (_, None) => continue,
                };
            }
        }
        let last = last.unwrap_or_else(|| panic!("offset {offset}: both are refused"));
        match hosts[0].answer(&mut board, Command::GetParameters { offset: 0 }) {
            Answer::Accepted(Payload::Parameters(ParametersPiece { id, .. })) => {
                // When both got through, the later one of them.
                let both = pushes.iter().all(|push| matches!(push, Push::Ended(true)));
                assert!(id == ids[last] || both && ids.contains(&id), "offset {offset}");
            }
            other => panic!("{other:?}"),
        }
    }
    println!(
        "of 241 pairs of pushes, the cable's got through {} times, the other {}",
        committed[0], committed[1]
    );
    assert!(committed.iter().all(|&count| count > 60), "{committed:?}");
    assert!(committed[0] + committed[1] < 2 * 241, "none were truly at once");
}
