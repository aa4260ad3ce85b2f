//! A stranger in the middle of a link, who has no key: whatever he holds back, repeats or answers in
//! the board's name, no host takes a write for done that the board has not done.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::time::Duration;

use wimu_host::calibration::parameter_id;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::transport::Transport;
use wimu_host::{Code, Result};
use wimu_link::auth::{DeviceKey, KeyId};
use wimu_link::message::{Payload, Refusal, Reply, Request, SetBytes, Settings, Signature};
use wimu_link::{Answer, Command, Deframer, Kind, LinkRole};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::scene::World;
use wimu_tests::{ROLES, encoded, sensor};

const KEY: DeviceKey = DeviceKey::new([0x11; 32]);

/// What he does with what is signed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Signed {
    /// Lets it through.
    Passes,
    /// Holds back what has an effect, and all reads from then on, and refuses them in the board's name.
    Refused(Refusal),
    /// Refuses it in the board's name, and lets it through.
    RefusedAndPasses(Refusal),
    /// Closes the link when a write has passed.
    Cut,
}

/// What he answers to what is not signed: as a board would, were it not that nothing of it is true.
#[derive(Clone, Copy, Debug)]
enum Key {
    /// He lets the question for the key through.
    Told,
    /// The board "has" this one.
    Forged(Option<KeyId>),
}

struct Middleman<'a> {
    link: SimLink<'a, Board>,
    signed: Signed,
    key: Key,
    from_host: Deframer,
    /// On its way to the host.
    forged: VecDeque<u8>,
    /// What the host wants to be told that the board holds.
    set: SetBytes,
    settings: Settings,
    /// A write with an effect has come by.
    begun: bool,
    cut: bool,
}

impl<'a> Middleman<'a> {
    fn on(link: SimLink<'a, Board>, key: Key, signed: Signed) -> Self {
        Self {
            link,
            signed,
            key,
            from_host: Deframer::new(),
            forged: VecDeque::new(),
            set: SetBytes::NONE,
            settings: Settings::default(),
            begun: false,
            cut: false,
        }
    }

    fn say(&mut self, request: &Request, answer: Answer) {
        let reply =
            Reply { session: request.session, id: request.id, signature: Signature::NONE, answer };
        // Ends whatever frame of the board's is under way.
        self.forged.push_back(0);
        self.forged.extend(encoded(|frame| reply.encode(frame)));
    }

    /// What the host wants to hear.
    fn pleasing(&mut self, command: &Command) -> Option<Payload> {
        Some(match *command {
            Command::GetParameters => Payload::Parameters(self.set),
            Command::SetSettings(_) | Command::GetSettings => Payload::Settings(self.settings),
            Command::SetParameters(_) | Command::FactoryReset => Payload::None,
            _ => return None,
        })
    }

    /// Whether a request goes on to the board.
    fn lets_through(&mut self, request: &Request) -> bool {
        self.begun |= request.command.is_write();
        match request.command {
            Command::SetParameters(set) => self.set = set,
            Command::SetSettings(settings) => self.settings = settings,
            Command::FactoryReset => self.set = SetBytes::NONE,
            _ => {}
        }
        if request.signature == Signature::NONE {
            if let (Command::GetKeyStatus, Key::Forged(key)) = (request.command, self.key) {
                self.say(request, Answer::Accepted(Payload::KeyStatus { key }));
                return false;
            }
            let pleasing = self.pleasing(&request.command);
            if let Some(pleasing) = pleasing {
                self.say(request, Answer::Accepted(pleasing));
            }
            return pleasing.is_none();
        }
        match self.signed {
            Signed::Refused(refusal) if self.begun => {
                self.say(request, Answer::Refused(refusal));
                false
            }
            Signed::RefusedAndPasses(refusal) if self.begun => {
                self.say(request, Answer::Refused(refusal));
                true
            }
            Signed::Cut if request.command.is_write() => {
                self.cut = true;
                true
            }
            _ => true,
        }
    }
}

impl Transport for Middleman<'_> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        if self.cut {
            let lost = "the other end closed the link";
            return Err(Code::LinkLost.error(lost, "connect again"));
        }
        if self.forged.is_empty() {
            return self.link.read(buffer, timeout);
        }
        let count = self.forged.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.forged.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let mut request = None;
        for &byte in bytes {
            if let Some(Ok(frame)) = self.from_host.push(byte)
                && frame.kind == Kind::Request
            {
                request = Request::decode(frame.body).ok();
            }
        }
        match request {
            Some(request) if !self.lets_through(&request) => Ok(()),
            _ => self.link.write_all(bytes),
        }
    }

    fn now(&self) -> Duration {
        self.link.now()
    }
}

fn options(session: u32) -> ConnectOptions {
    ConnectOptions { session: Some(session), ..ConnectOptions::default() }
}

fn set_of(bias: f64) -> ParameterSet {
    let terms = ErrorTerms { bias_mps2: [bias, 0.0, 0.0], ..ErrorTerms::default() };
    ParameterSet {
        model: ErrorModel::new(terms).expect("a model"),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).expect("its own"))
    }
}

fn faster() -> Settings {
    Settings { rate_hz: 200, ..Settings::default() }
}

/// A board with a key, a calibration and settings as from the factory.
fn start() -> RefCell<Board> {
    let source = sensor("rest", World::default(), 3);
    let board = RefCell::new(Board::start(BoardConfig::default(), source));
    let cable = SimLink::new(&board, LinkRole::Cable);
    let mut cable = Client::connect(cable, "cable", options(1)).expect("a board");
    cable.set_key(KEY).expect("set");
    cable.push_parameters(&set_of(0.1)).expect("pushed");
    board
}

/// The parameters and settings that a board truly holds.
fn truth(board: &RefCell<Board>, session: u32) -> (u32, Settings) {
    // What is under way arrives before.
    let later = board.borrow().now_us() + 1_000_000;
    board.borrow_mut().run_until(later);
    let cable = SimLink::new(board, LinkRole::Cable);
    let mut cable = Client::connect(cable, "cable", options(session)).expect("a board");
    let held = cable.parameters().expect("answered").id;
    (held, cable.settings().expect("answered"))
}

type Write = fn(&mut Client<Middleman<'_>>) -> Result<()>;

/// The writes, and what the board holds after each.
fn writes() -> [(&'static str, Write, (u32, Settings)); 3] {
    let held = parameter_id(&set_of(0.1)).0;
    let pushed = parameter_id(&set_of(0.2)).0;
    [
        (
            "push",
            |client| client.push_parameters(&set_of(0.2)).map(drop),
            (pushed, Settings::default()),
        ),
        ("settings", |client| client.set_settings(faster()).map(drop), (held, faster())),
        ("reset", |client| client.factory_reset(), (0, Settings::default())),
    ]
}

/// Has an owner write through a middleman; returns what he is told, and whether the board did it.
fn write_through(key: Key, signed: Signed, role: LinkRole, which: usize) -> (Result<()>, bool) {
    let board = start();
    let before = truth(&board, 8);
    let (_, write, after) = writes()[which];
    let middleman = Middleman::on(SimLink::new(&board, role), key, signed);
    let mut client = Client::connect(middleman, "the link", options(2)).expect("a board");
    let told = client.use_key_among(&[KEY]).and_then(|_| write(&mut client));
    let found = truth(&board, 9);
    assert!(found == before || found == after);
    (told, found == after)
}

#[test]
fn nobody_without_the_key_makes_a_host_believe_that_a_write_was_done() {
    let refusals =
        [Refusal::KeyNeeded, Refusal::WrongSignature, Refusal::SessionEnded, Refusal::Locked];
    let mut ways = vec![
        (Key::Forged(None), Signed::Passes, Code::KeyNeeded),
        (Key::Forged(Some(KeyId([1, 2, 3, 4]))), Signed::Passes, Code::KeyNeeded),
        // He closes the link: it may have been done.
        (Key::Told, Signed::Cut, Code::LinkLost),
    ];
    ways.extend(refusals.map(|refusal| (Key::Told, Signed::Refused(refusal), Code::NoAnswer)));
    for (key, signed, expected) in ways {
        for role in ROLES {
            for (which, (name, ..)) in writes().into_iter().enumerate() {
                let (told, done) = write_through(key, signed, role, which);
                let error = told.expect_err("never done");
                let case = format!("{name} over the {role} link, {key:?}, {signed:?}: {error}");
                assert_eq!(error.code, expected, "{case}");
                // Where the write itself has been sent, it may have been done.
                let sent = expected != Code::KeyNeeded;
                assert_eq!(error.text.contains("may have been executed"), sent, "{case}");
                assert_eq!(done, signed == Signed::Cut, "{case}");
            }
        }
    }
}

#[test]
fn a_write_that_was_done_and_refused_by_a_stranger_is_never_said_to_have_failed() {
    for refusal in [Refusal::KeyNeeded, Refusal::WrongSignature] {
        for (which, (name, ..)) in writes().into_iter().enumerate() {
            let signed = Signed::RefusedAndPasses(refusal);
            let (told, done) = write_through(Key::Told, signed, LinkRole::Wireless, which);
            assert!(done, "{name}");
            let code = told.as_ref().err().map(|problem| problem.code);
            assert!([None, Some(Code::NoAnswer)].contains(&code), "{told:?}");
        }
    }
}

#[test]
fn a_stranger_who_lets_all_pass_changes_nothing() {
    for role in ROLES {
        for (which, (name, ..)) in writes().into_iter().enumerate() {
            let (told, done) = write_through(Key::Told, Signed::Passes, role, which);
            assert_eq!((told, done), (Ok(()), true), "{name}");
        }
    }
}

#[test]
fn what_nobody_has_signed_is_no_answer_to_a_write_over_a_radio() {
    for (name, write, _) in writes() {
        let board = start();
        let link = SimLink::new(&board, LinkRole::Wireless);
        let middleman = Middleman::on(link, Key::Told, Signed::Passes);
        let mut client = Client::connect(middleman, "the link", options(2)).expect("a board");
        let error = write(&mut client).expect_err("never done");
        assert_eq!(error.code, Code::KeyNeeded, "{name}: {error}");
        assert!(error.text.contains("unsigned write"), "{error}");
    }
}

#[test]
fn what_is_read_in_a_session_is_the_boards_or_nothing() {
    for refusal in [Refusal::KeyNeeded, Refusal::WrongSignature] {
        let board = start();
        let link = SimLink::new(&board, LinkRole::Wireless);
        let middleman = Middleman::on(link, Key::Told, Signed::Refused(refusal));
        let mut client = Client::connect(middleman, "the link", options(2)).expect("a board");
        assert_eq!(client.use_key_among(&[KEY]), Ok(true));
        assert_eq!(client.settings(), Ok(Settings::default()));
        assert!(client.set_settings(faster()).is_err());
        // He would say otherwise now, were he asked without a signature.
        let read = client.settings().map_err(|error| error.code);
        assert_eq!(read, Err(Code::KeyNeeded));
        assert!(client.parameters().is_err() && client.status().is_err());
    }
}
