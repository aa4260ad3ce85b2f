//! A stranger who fills the wireless link of a board that has a key with requests: telemetry goes
//! on, and what the owner asks is done.

use std::cell::RefCell;
use std::fmt;
use std::time::Duration;

use wimu_host::Result;
use wimu_host::calibration::parameter_id;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::Event;
use wimu_host::transport::Transport;
use wimu_link::auth::DeviceKey;
use wimu_link::message::{Settings, Signature};
use wimu_link::{Command, LinkRole, Request, WIRE_VERSION};
use wimu_model::{
    CalibrationMethod, CalibrationQuality, ErrorModel, ErrorTerms, ModelCovariance, ParameterSet,
    QualityTerms, Sensitivity, TermDeviations,
};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::scene::World;
use wimu_testkit::{Lane, figure};
use wimu_tests::{Random, compiled, encoded, frame_of, sensor, who_are_you};

const KEY: DeviceKey = DeviceKey::new([0x11; 32]);
const CABLE: LinkRole = LinkRole::Cable;
const WIRELESS: LinkRole = LinkRole::Wireless;
/// What a line of 115,200 baud carries in a millisecond, bytes.
const BYTES_PER_MS: f64 = 11.52;
/// Interval over which samples are counted, s.
const COUNTED_S: u64 = 4;

/// What the stranger sends.
#[derive(Clone, Copy, Debug)]
enum Attack {
    /// This, unsigned.
    Unsigned(Command, Ids),
    /// A command that no device knows.
    Unknown,
    /// This, with a signature that he has made up.
    Forged(Command),
    /// What the owner has signed last, again.
    Replayed,
    /// The question who is there.
    WhoAreYou,
    /// All of these by turns.
    Mixed,
}

/// How he numbers unsigned requests.
#[derive(Clone, Copy, Debug)]
enum Ids {
    /// Each is the first of a new session.
    NewSessions,
    /// All are of one session.
    Counted,
    /// All are the same.
    Repeated,
    /// As the owner does, in whose session they are, but farther on.
    Owners,
}

const IDS: [Ids; 4] = [Ids::NewSessions, Ids::Counted, Ids::Repeated, Ids::Owners];

/// One of each kind.
fn commands() -> Vec<Command> {
    let all = vec![
        Command::GetParameters,
        Command::SetParameters(compiled(&set_of(0.4))),
        Command::FactoryReset,
        Command::GetSettings,
        Command::SetSettings(Settings::default()),
        Command::GetStatus,
        Command::SetLineRate { baud: 9600 },
        Command::OpenSession,
        Command::GetKeyStatus,
        Command::SetKey(DeviceKey::new([0x22; 32])),
        Command::ForgetKey,
        Command::GetTime,
    ];
    for (index, command) in all.iter().enumerate() {
        // Does not compile when there is another one: give it its number here, and add it above.
        let number = match command {
            Command::GetParameters => 0,
            Command::SetParameters(_) => 1,
            Command::FactoryReset => 2,
            Command::GetSettings => 3,
            Command::SetSettings(_) => 4,
            Command::GetStatus => 5,
            Command::SetLineRate { .. } => 6,
            Command::OpenSession => 7,
            Command::GetKeyStatus => 8,
            Command::SetKey(_) => 9,
            Command::ForgetKey => 10,
            Command::GetTime => 11,
        };
        assert_eq!(index, number);
    }
    all
}

fn attacks() -> Vec<Attack> {
    let unsigned =
        commands().into_iter().flat_map(|command| IDS.map(|ids| Attack::Unsigned(command, ids)));
    let others = [
        Attack::Unknown,
        Attack::Forged(Command::GetParameters),
        Attack::Forged(Command::FactoryReset),
        Attack::Replayed,
        Attack::WhoAreYou,
        Attack::Mixed,
    ];
    unsigned.chain(others).collect()
}

/// The stranger, and the bytes that have been put on the line.
struct Stranger {
    attack: Attack,
    seeded: Random,
    count: u32,
    /// The owner's unsigned session.
    owners: u32,
    /// What the owner has signed last.
    signed: Option<Vec<u8>>,
    since_us: u64,
    bytes: usize,
}

impl Stranger {
    fn new(attack: Attack, board: &RefCell<Board>) -> Self {
        Self {
            attack,
            seeded: Random::new(9),
            count: 0,
            owners: 0,
            signed: None,
            since_us: board.borrow().now_us(),
            bytes: 0,
        }
    }

    fn frame(&mut self, attack: Attack) -> Vec<u8> {
        self.count += 1;
        let random = self.seeded.bits() as u32;
        let request = |session, id, signature, command| {
            encoded(|frame| {
                let request = Request { session, id, signature, command };
                request.encode(frame)
            })
        };
        match attack {
            Attack::Unsigned(command, ids) => {
                let (session, id) = match ids {
                    Ids::NewSessions => (random, 1),
                    Ids::Counted => (5, self.count),
                    Ids::Repeated => (6, 1),
                    Ids::Owners => (self.owners, 1000 + self.count),
                };
                request(session, id, Signature::NONE, command)
            }
            // A session that is not the owner's, id, no signature, command 77.
            Attack::Unknown => {
                let [session, id] = [random % 90, self.count % 128].map(|number| number as u8);
                frame_of(WIRE_VERSION, 5, &[session, id, 0, 77])
            }
            Attack::Forged(command) => {
                let made_up = Signature::new(&self.seeded.bits().to_le_bytes());
                let session = 1 + random % 40;
                request(session, random, made_up.expect("8 bytes"), command)
            }
            Attack::Replayed => self.signed.clone().unwrap_or_else(|| vec![0; 20]),
            Attack::WhoAreYou => who_are_you(),
            Attack::Mixed => {
                let all = attacks();
                // All but the last, which is this.
                let which = self.seeded.below(all.len() - 1);
                self.frame(all[which])
            }
        }
    }
}

/// The wireless link as the owner has it: what he sends goes between the stranger's frames, which fill
/// the line otherwise.
struct Flooded<'a> {
    link: SimLink<'a, Board>,
    stranger: &'a RefCell<Stranger>,
}

impl Transport for Flooded<'_> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let end = self.link.now() + timeout;
        loop {
            let now = self.link.now();
            let mut stranger = self.stranger.borrow_mut();
            let since_ms = (now.as_micros() as u64 - stranger.since_us) / 1000;
            while (stranger.bytes as f64) < (since_ms + 1) as f64 * BYTES_PER_MS {
                let attack = stranger.attack;
                let frame = stranger.frame(attack);
                stranger.bytes += frame.len();
                self.link.write_all(&frame)?;
            }
            drop(stranger);
            let step = Duration::from_millis(1).min(end.saturating_sub(now));
            let count = self.link.read(buffer, step)?;
            if count > 0 || self.link.now() >= end {
                return Ok(count);
            }
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let mut stranger = self.stranger.borrow_mut();
        stranger.bytes += bytes.len();
        let mut deframer = wimu_link::Deframer::new();
        for &byte in bytes {
            if let Some(Ok(frame)) = deframer.push(byte)
                && let Ok(request) = Request::decode(frame.body)
            {
                match request.signature {
                    Signature::NONE => stranger.owners = request.session,
                    _ => stranger.signed = Some(bytes.to_vec()),
                }
            }
        }
        self.link.write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.link.now()
    }
}

fn options(session: u32) -> ConnectOptions {
    ConnectOptions { session: Some(session), ..ConnectOptions::default() }
}

/// A set with all that a calibration of an accelerometer says of itself: its reply has 640 bytes.
fn set_of(bias: f64) -> ParameterSet {
    let terms = ErrorTerms { bias_mps2: [bias, 0.0, 0.0], ..ErrorTerms::default() };
    let quality = QualityTerms {
        method: CalibrationMethod::MultiPosition,
        utc_s: Some(1_700_000_000),
        temperature: None,
        poses: 20,
        dof: 8,
        rms_mps2: 0.002,
        loo_rms_mps2: Some(0.003),
        condition: Some(2.5),
        covariance: ModelCovariance::from_matrix(&std::array::from_fn(|a| {
            std::array::from_fn(|b| if a == b { 2e-6 } else { 1e-6 })
        }))
        .expect("a covariance"),
        other_sd: TermDeviations::default(),
    };
    ParameterSet {
        model: ErrorModel::new(terms).expect("a model"),
        quality: Some(CalibrationQuality::new(quality).expect("within bounds")),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).expect("its own"))
    }
}

/// A board with a key and a calibration.
fn start(rate_hz: u16) -> RefCell<Board> {
    let source = sensor("rest", World::default(), 3);
    let board = RefCell::new(Board::start(BoardConfig::default(), source));
    let cable = SimLink::new(&board, CABLE);
    let mut cable = Client::connect(cable, "cable", options(1)).expect("a board");
    cable.set_key(KEY).expect("set");
    cable.push_parameters(&set_of(0.1)).expect("pushed");
    let settings = Settings { rate_hz, ..Settings::default() };
    cable.set_settings(settings).expect("set");
    drop(cable);
    board
}

/// Samples of both streams that arrive in `COUNTED_S`.
fn samples<T: Transport>(client: &mut Client<T>) -> u64 {
    let received = |client: &Client<T>| {
        let statistics = client.statistics();
        statistics.raw.received + statistics.corrected.received
    };
    let before = received(client);
    let end = client.transport().now() + Duration::from_secs(COUNTED_S);
    while client.transport().now() < end {
        let left = end - client.transport().now();
        client.next_event(left).expect("a link");
    }
    received(client) - before
}

impl fmt::Display for Attack {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let long = format!("{self:?}");
        let (name, ids) = match self {
            Self::Unsigned(command, ids) => (format!("{command:?}"), format!("{ids:?}")),
            _ => (long, String::new()),
        };
        let name = name.split([' ', '{']).next().unwrap_or_default();
        let name = name.split("(WireP").next().unwrap_or_default();
        write!(out, "{name} {ids}")
    }
}

struct Outcome {
    /// Of those that arrive undisturbed.
    samples: f64,
    pushed: u32,
    longest: Duration,
}

/// Floods a board, pushes from `pushes` new connections, and counts samples.
fn under(attack: Attack, rate_hz: u16, pushes: u32) -> Outcome {
    let board = start(rate_hz);
    let link = SimLink::new(&board, WIRELESS);
    let mut quiet = Client::connect(link, "quiet", options(2)).expect("a board");
    let usual = samples(&mut quiet);
    drop(quiet);
    let stranger = RefCell::new(Stranger::new(attack, &board));
    let flooded = || Flooded { link: SimLink::new(&board, WIRELESS), stranger: &stranger };
    let mut outcome = Outcome { samples: 0.0, pushed: 0, longest: Duration::ZERO };
    let mut held = None;
    for push in 0..pushes {
        let set = set_of(0.2 + f64::from(push) * 1e-3);
        let begun = flooded().now();
        let pushed =
            Client::connect(flooded(), "the link", options(100 + push)).and_then(|mut client| {
                client.use_key_among(&[KEY])?;
                client.push_parameters(&set)
            });
        outcome.longest = outcome.longest.max(flooded().now() - begun);
        match pushed {
            Ok(id) => {
                held = Some(id);
                outcome.pushed += 1;
            }
            Err(error) => println!("{attack}: {error}"),
        }
    }
    // Counted while the flood lasts.
    match Client::connect(flooded(), "the link", options(99)) {
        Ok(mut client) => outcome.samples = samples(&mut client) as f64 / usual as f64,
        Err(error) => println!("{attack}: {error}"),
    }
    if let Some(id) = held {
        let cable = SimLink::new(&board, CABLE);
        let mut cable = Client::connect(cable, "cable", options(3)).expect("a board");
        let found = cable.parameters().expect("answered");
        assert_eq!(found.id, id.0, "{attack:?}");
        assert_eq!(cable.key_status(), Ok(Some(KEY.id())), "{attack:?}");
    }
    outcome
}

/// Every attack on a board of so many samples a second, with so many pushes for each way of numbering
/// requests.
fn all(rate_hz: u16, pushes: u32) {
    let mut failed = Vec::new();
    let (mut all, mut through) = (0, 0);
    let (mut longest, mut fewest) = (Duration::ZERO, 1.0_f64);
    for attack in attacks() {
        let pushes = match attack {
            Attack::Unsigned(..) => pushes,
            _ => pushes * IDS.len() as u32,
        };
        let outcome = under(attack, rate_hz, pushes);
        println!(
            "{attack}: {} of {pushes} pushes, the longest in {:.2} s; {:.0} % of the samples",
            outcome.pushed,
            outcome.longest.as_secs_f64(),
            100.0 * outcome.samples
        );
        all += pushes;
        through += outcome.pushed;
        longest = longest.max(outcome.longest);
        fewest = fewest.min(outcome.samples);
        if outcome.pushed < pushes || outcome.samples < 0.5 {
            failed.push(attack.to_string());
        }
    }
    let claim = format!("floods of unsigned requests, {rate_hz} Hz: owner's pushes");
    let measured = format!("{through} of {all}, {:.1} s", longest.as_secs_f64());
    figure(&claim, measured, "all", through == all);
    let claim = format!("floods of unsigned requests, {rate_hz} Hz: samples that arrive");
    let measured = format!("{:.0} %", 100.0 * fewest);
    figure(&claim, measured, "at least 50 %", fewest >= 0.5);
    assert!(failed.is_empty(), "{} fail: {failed:?}", failed.len());
}

#[test]
fn no_flood_of_requests_stops_telemetry_or_the_owner() {
    all(100, Lane::current().choose([1, 2, 25]));
}

#[test]
#[ignore = "minutes: cargo xtask campaign link"]
fn at_400_hz_no_flood_of_requests_stops_telemetry_or_the_owner() {
    all(400, 25);
}

#[test]
fn hosts_without_the_key_are_answered_as_often_as_they_usually_ask() {
    let board = start(100);
    let connect = |session| {
        let link = SimLink::new(&board, WIRELESS);
        Client::connect(link, "the link", options(session)).expect("a board")
    };
    // One after the other, without a pause.
    let begun = Duration::from_micros(board.borrow().now_us());
    for session in 10..14 {
        let mut host = connect(session);
        let held = host.parameters().expect("answered").id;
        assert_eq!(held, parameter_id(&set_of(0.1)).0);
        assert_eq!(host.settings(), Ok(Settings::default()));
        assert!(host.status().is_ok());
        assert_eq!(host.key_status(), Ok(Some(KEY.id())));
    }
    let took = Duration::from_micros(board.borrow().now_us()) - begun;
    assert!(took < Duration::from_secs(4), "{took:?}");
    // One that asks for the time 40 times a second.
    let mut host = connect(20);
    let mut answered = 0;
    for _ in 0..400 {
        host.ask_time().expect("a link");
        let next = host.transport().now() + Duration::from_millis(25);
        while host.transport().now() < next {
            let left = next - host.transport().now();
            let arrival = host.next_event(left).expect("a link");
            answered += u32::from(matches!(
                arrival.map(|arrival| arrival.event),
                Some(Event::Reply { .. })
            ));
        }
    }
    assert!(answered >= 399, "{answered} of 400");
}
