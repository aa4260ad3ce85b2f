//! Two hosts that push at the same moment, one on each link.

use std::time::Duration;

use wimu_host::calibration::parameter_id;
use wimu_link::auth::{DeviceKey, Session};
use wimu_link::message::Payload;
use wimu_link::requester::Next;
use wimu_link::{Answer, Command, Deframer, Kind, LinkRole, Requester};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::scene::World;
use wimu_tests::{ROLES, compiled, sensor};

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
    Asked,
    Done,
}

#[test]
fn of_two_pushes_at_once_both_are_done_one_after_the_other() {
    let config = BoardConfig::default();
    let device_id = config.device_id;
    let mut board = Board::start(config, sensor("rest", World::default(), 3));
    let mut hosts = [Host::new(LinkRole::Cable, 1), Host::new(LinkRole::Wireless, 2)];
    let answer = hosts[0].answer(&mut board, Command::SetKey(KEY));
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    for host in &mut hosts {
        host.sign(&mut board, device_id);
    }
    let mut later = [0; 2];
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
        let begin = board.now_us();
        let late = begin + offset.unsigned_abs() * STEP_US;
        let [cable, wireless] = if offset < 0 { [late, begin] } else { [begin, late] };
        let mut pushes = [Push::At(cable), Push::At(wireless)];
        while !pushes.iter().all(|push| matches!(push, Push::Done)) {
            assert!(board.now_us() < begin + 5_000_000, "offset {offset}");
            step(&mut board);
            for ((host, push), set) in hosts.iter_mut().zip(&mut pushes).zip(&sets) {
                let answer = host.look(&mut board);
                *push = match (&*push, answer) {
                    (Push::At(at), _) if board.now_us() >= *at => {
                        host.ask(&mut board, Command::SetParameters(compiled(set)));
                        Push::Asked
                    }
                    (Push::Asked, Some(Answer::Accepted(_))) => Push::Done,
                    (_, Some(other)) => panic!("offset {offset}: {other:?}"),
                    (_, None) => continue,
                };
            }
        }
        let held = match hosts[0].answer(&mut board, Command::GetParameters) {
            Answer::Accepted(Payload::Parameters(bytes)) => bytes.set().expect("a set"),
            other => panic!("{other:?}"),
        };
        let id = held.expect("one").source();
        let which = sets.iter().position(|set| parameter_id(set) == id);
        later[which.expect("one of them")] += 1;
    }
    assert!(later.iter().all(|&count| count > 60), "{later:?}");
}
