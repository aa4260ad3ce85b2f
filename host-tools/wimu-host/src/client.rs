//! A live board: who it is, what it sends, requests and their answers.

use std::cmp::Ordering;
use std::collections::VecDeque;
use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use wimu_link::auth::{DeviceKey, KeyId, Session};
use wimu_link::message::{
    ActiveParameters, Answer, Event as DeviceEvent, Payload, Refusal, Status, WireParameters,
    parameter_id,
};
use wimu_link::requester::Next;
use wimu_link::{
    Command, Hello, LinkRole, MAX_FRAME, Requester, Settings, WIRE_VERSION, WhoAreYou,
};
use wimu_model::{ParameterId, ParameterSet};

use crate::clock::wire_length;
use crate::decode::{Arrival, Decoder, Event, LinkStatistics};
use crate::error::{ErrorCode, HostError, Result};
use crate::keys;
use crate::link_url::LinkUrl;
use crate::transport::{self, Transport};

/// A board is asked who it is this often.
const ASK_EVERY: Duration = Duration::from_millis(400);
/// A request is repeated in so many sessions when they end under it.
const SESSIONS: usize = 4;
/// Rates at which a board is looked for.
const USUAL_BAUDS: [u32; 8] = [
    115_200, 9600, 38_400, 57_600, 230_400, 460_800, 921_600, 19_200,
];
/// The board hears us at a new rate within this, or not at all.
const RATE_PATIENCE: Duration = Duration::from_secs(3);
/// It is back at the old rate within this.
const FALL_BACK_PATIENCE: Duration = Duration::from_secs(8);
/// No longer than this between looks at the clock.
const GLANCE: Duration = Duration::from_millis(50);

/// How to connect.
#[derive(Clone, Copy, Debug)]
pub struct ConnectOptions {
    /// How long to wait for the board to say who it is.
    pub patience: Duration,
    /// Tells this host from others in requests; random where it is `None`.
    pub session: Option<u32>,
}

impl Default for ConnectOptions {
    /// 3 s, a random session.
    fn default() -> Self {
        Self {
            patience: Duration::from_secs(3),
            session: None,
        }
    }
}

impl ConnectOptions {
    /// 1 s, for a port that may or may not be a board.
    pub fn probe() -> Self {
        Self {
            patience: Duration::from_secs(1),
            ..Self::default()
        }
    }
}

/// Opens a link and connects to the board behind it; `auto` tries the ports that look like one,
/// 1 s each.
///
/// # Errors
/// Those of [`transport::open`] and [`Client::connect`]. For `auto`, those of the last port tried.
pub fn connect(link: &LinkUrl) -> Result<Client<Box<dyn Transport + Send>>> {
    if let LinkUrl::Serial { baud: None, .. } = link {
        return Client::find_rate(transport::open(link)?, &link.to_string());
    }
    if *link != LinkUrl::Auto {
        let transport = transport::open(link)?;
        return Client::connect(transport, &link.to_string(), ConnectOptions::default());
    }
    let mut outcome = Err(HostError::new(
        ErrorCode::LinkAbsent,
        "there is no port to try",
        "plug the board in",
    ));
    for candidate in transport::candidates()? {
        outcome = transport::open(&candidate).and_then(|transport| {
            Client::connect(transport, &candidate.to_string(), ConnectOptions::probe())
        });
        if outcome.is_ok() {
            break;
        }
    }
    outcome
}

/// Whose rate a radio's line has, and how to set it.
pub fn adapter_decides(link: &str, baud: u32) -> HostError {
    HostError::new(
        ErrorCode::Usage,
        "this link goes over a radio adapter, which decides the rate of the board's line: setting it here means nothing",
        format!(
            "set the adapter itself in its command mode (HC-05: AT+UART={baud},0,0; HC-06: AT+BAUD8 for 115200; others alike); \
             the board finds 115200, 9600 and 38400 by itself, and others after `wimu settings set CABLE --wireless-baud {baud}`"
        ),
    )
    .at(link)
}

/// A connection to a board.
///
/// What arrives while it waits for something else is kept for [`Client::next_event`], in order.
pub struct Client<T> {
    transport: T,
    name: String,
    decoder: Decoder,
    requester: Requester,
    hello: Hello,
    /// Arrived and not yet handed out.
    arrivals: VecDeque<Arrival>,
    /// The answer to the request under way, when it has arrived.
    answer: Option<Answer>,
    /// What the board's writes are signed with.
    key: Option<DeviceKey>,
    /// The seed of sessions that are to be the same in every run.
    seed: Option<u32>,
    /// The device writes its flash until then and hears nothing.
    deaf_until: Duration,
    /// Length of the latest status on the wire.
    status_bytes: usize,
}

impl<T: Transport> Client<T> {
    /// Asks the board who it is and waits for its answer; `name` is what errors call the link.
    ///
    /// # Errors
    /// `not_a_wimu_board` when none comes, `protocol_version` when the board speaks another one,
    /// `link_busy` when the other end closes the link at once, `link_lost` when it does so later.
    pub fn connect(transport: T, name: &str, options: ConnectOptions) -> Result<Self> {
        let mut client = Self::new(transport, name, options.session);
        client.greet(options.patience)?;
        Ok(client)
    }

    fn new(transport: T, name: &str, session: Option<u32>) -> Self {
        let random = || RandomState::new().hash_one(name) as u32;
        Self {
            transport,
            name: name.to_owned(),
            decoder: Decoder::new(),
            requester: Requester::new(session.unwrap_or_else(random)),
            hello: Hello::new(wimu_link::LinkRole::Other(0)),
            arrivals: VecDeque::new(),
            answer: None,
            key: None,
            seed: session,
            deaf_until: Duration::ZERO,
            status_bytes: 0,
        }
    }

    /// Connects at the rate at which the board answers: tries the usual ones, 1 s each.
    ///
    /// # Errors
    /// `not_a_wimu_board` when none is the board's; those of [`Client::connect`].
    pub fn find_rate(mut transport: T, name: &str) -> Result<Self> {
        for baud in USUAL_BAUDS {
            transport.set_baud(baud)?;
            let mut client = Self::new(transport, name, None);
            match client.greet(ConnectOptions::probe().patience) {
                Ok(()) => return Ok(client),
                Err(error) if error.code() != ErrorCode::NotAWimuBoard => return Err(error),
                Err(_) => transport = client.transport,
            }
        }
        Err(HostError::new(
            ErrorCode::NotAWimuBoard,
            format!("no wimu board answers at any of {USUAL_BAUDS:?} baud"),
            "check that the board is powered and runs wimu, and that TX and RX are not swapped",
        )
        .at(name))
    }

    /// Changes the rate of the line at both ends, and stores it on the board.
    ///
    /// # Errors
    /// `usage` for a link without a rate, or a radio's, whose adapter decides; those of
    /// [`Client::request`]; `no_answer` when the board is not heard at the new rate: both ends are at
    /// the old one again then.
    pub fn set_line_rate(&mut self, baud: u32) -> Result<()> {
        let Some(before) = self.transport.baud() else {
            return self
                .transport
                .set_baud(baud)
                .map_err(|error| error.at(&self.name));
        };
        if self.hello.role != LinkRole::Cable {
            return Err(adapter_decides(&self.name, baud));
        }
        let link = LinkRole::Cable.number();
        match self.request(Command::SetLineRate { link, baud }) {
            // The answer may be lost and the rate changed: the board tells.
            Err(error) if error.code() != ErrorCode::NoAnswer => return Err(error),
            _ => {}
        }
        self.transport.set_baud(baud)?;
        self.decoder.interrupt();
        if self.greet(RATE_PATIENCE).is_ok() {
            return Ok(());
        }
        self.transport.set_baud(before)?;
        self.decoder.interrupt();
        // The board comes back when it has not heard us for 5 s.
        self.greet(FALL_BACK_PATIENCE)?;
        Err(HostError::new(
            ErrorCode::NoAnswer,
            format!("the board is not heard at {baud} baud; it is back at {before}"),
            "the cable or the adapter between may not carry this rate: choose a lower one",
        )
        .at(&self.name))
    }

    /// Goes on with a new transport to the same board after the old one was lost: with what is
    /// known, counted and numbered so far.
    ///
    /// # Errors
    /// Those of [`Client::connect`]; `link_lost` when another board, or its other link, answers.
    pub fn resume(&mut self, transport: T) -> Result<()> {
        self.transport = transport;
        self.decoder.interrupt();
        self.answer = None;
        self.deaf_until = Duration::ZERO;
        let (known, role) = (self.hello.device_id, self.hello.role);
        let greeted = self.greet(ConnectOptions::default().patience);
        let hello = self.hello;
        if greeted.is_ok() && (hello.device_id, hello.role) != (known, role) {
            self.hello.device_id = known;
            self.hello.role = role;
            return Err(HostError::new(
                ErrorCode::LinkLost,
                format!(
                    "now the {} link of device {:016x} answers",
                    hello.role, hello.device_id
                ),
                "put the first board back, or make another recording",
            )
            .at(&self.name));
        }
        greeted
    }

    fn greet(&mut self, patience: Duration) -> Result<()> {
        let mut question = [0; MAX_FRAME + 1];
        // The zero in front ends whatever a host before may have left unfinished.
        let length = WhoAreYou::default()
            .encode(&mut question[1..])
            .map_or(0, |length| length + 1);
        let start = self.transport.now();
        let mut ask_at = start;
        // A greeting of before is none.
        let mut looked_at = self.arrivals.len();
        loop {
            let now = self.transport.now();
            if now >= start + patience {
                return Err(self.no_greeting());
            }
            if now >= ask_at {
                let asked = self.transport.write_all(&question[..length]);
                asked.map_err(|error| self.turned_away(error))?;
                ask_at = now + ASK_EVERY;
            }
            self.poll(GLANCE).map_err(|error| self.turned_away(error))?;
            let greeting =
                self.arrivals
                    .iter()
                    .skip(looked_at)
                    .find_map(|arrival| match arrival.event {
                        Event::Hello(hello) => Some(hello),
                        _ => None,
                    });
            looked_at = self.arrivals.len();
            if let Some(hello) = greeting {
                self.hello = hello;
                return if hello.wire_version == WIRE_VERSION {
                    Ok(())
                } else {
                    Err(self.foreign(hello.wire_version))
                };
            }
        }
    }

    /// A link that ends before it has brought anything: a server that serves one host at a time.
    fn turned_away(&self, error: HostError) -> HostError {
        if error.code() != ErrorCode::LinkLost || self.decoder.statistics().bytes > 0 {
            return error;
        }
        HostError::new(
            ErrorCode::LinkBusy,
            "the other end closed the link at once",
            "another program may be using it: close that one; else check the address",
        )
        .at(&self.name)
    }

    /// A board of another wire version.
    fn foreign(&self, version: u8) -> HostError {
        let older = match version.cmp(&WIRE_VERSION) {
            Ordering::Less => "the board's firmware",
            _ => "wimu on this computer",
        };
        HostError::new(
            ErrorCode::ProtocolVersion,
            format!(
                "the board speaks version {version} of the protocol, this wimu version {WIRE_VERSION}"
            ),
            format!("update {older}, which is the older one"),
        )
        .at(&self.name)
    }

    fn no_greeting(&self) -> HostError {
        if let Some(version) = self.decoder.foreign_version() {
            return self.foreign(version);
        }
        let statistics = self.decoder.statistics();
        let (message, remedy) = if statistics.bytes == 0 {
            (
                "nothing answers".to_owned(),
                "check that the board is powered and runs wimu, and that TX and RX are not swapped",
            )
        } else if statistics.frames == 0 {
            (
                format!(
                    "{} bytes arrived, but nothing that a wimu board says",
                    statistics.bytes
                ),
                "check the baud rate at both ends, and that this is the board's port",
            )
        } else {
            (
                format!(
                    "the board does not say who it is, though {} of its frames arrived",
                    statistics.frames
                ),
                "check the line from this computer to the board: it may not hear",
            )
        };
        HostError::new(ErrorCode::NotAWimuBoard, message, remedy).at(&self.name)
    }

    /// Who the board was when it last said so.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// What errors call the link.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the link carried and lost so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.decoder.statistics()
    }

    /// The link below: for its clock.
    pub fn transport(&mut self) -> &mut T {
        &mut self.transport
    }

    /// The next event, waiting for at most `timeout`; `None` if there is none by then.
    ///
    /// # Errors
    /// `link_lost`; what arrived before has been handed out by then.
    pub fn next_event(&mut self, timeout: Duration) -> Result<Option<Arrival>> {
        let until = self.transport.now() + timeout;
        loop {
            if let Some(arrival) = self.arrivals.pop_front() {
                return Ok(Some(arrival));
            }
            let left = until.saturating_sub(self.transport.now());
            if left.is_zero() && !timeout.is_zero() {
                return Ok(None);
            }
            self.poll(left)?;
            if timeout.is_zero() {
                return Ok(self.arrivals.pop_front());
            }
        }
    }

    /// Signs with this key from the next write on, if the board asks for it.
    pub fn use_key(&mut self, key: Option<DeviceKey>) {
        self.key = key;
        self.requester.sign_nothing();
    }

    /// Signs with the key of those that the board has; returns whether there is one.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn use_key_among(&mut self, keys: &[DeviceKey]) -> Result<bool> {
        if !keys.is_empty() {
            let held = self.key_status()?;
            let ours = keys.iter().find(|key| Some(key.id()) == held);
            self.use_key(ours.copied());
        }
        Ok(self.key.is_some())
    }

    /// Asks for something and waits for the answer, repeating the question as often as it takes.
    /// Writes to a board that has a key are signed, and so is everything from then on.
    ///
    /// # Errors
    /// `device_refused` or `key_needed` with the board's reason; `no_answer`, after which the
    /// request may have had its effect all the same; `link_lost`.
    pub fn request(&mut self, command: Command) -> Result<Payload> {
        let signs = self.requester.signs();
        if command.is_write() && self.key.is_some() && !signs {
            self.open_session()?;
        }
        for _ in 0..SESSIONS {
            match self.ask(command)? {
                // The board has started anew, or this is another one's doing. What is asked for
                // twice is done once, or is the same.
                Answer::Refused(Refusal::SessionEnded | Refusal::WrongSignature)
                    if self.requester.signs() =>
                {
                    self.open_session()?;
                }
                // It has forgotten its key.
                Answer::Refused(Refusal::KeyNeeded)
                    if self.requester.signs() && !command.is_write() =>
                {
                    self.requester.sign_nothing();
                }
                answer => return self.accepted(answer),
            }
        }
        // It is not the board's key: reading needs none.
        self.requester.sign_nothing();
        self.accepted(Answer::Refused(Refusal::WrongSignature))
    }

    /// Has the board open a session, in which requests are signed from now on.
    fn open_session(&mut self) -> Result<()> {
        let Some(key) = self.key else {
            return Ok(());
        };
        let answer = self.ask(Command::OpenSession)?;
        let (number, nonce) = match self.accepted(answer)? {
            Payload::Session { number, nonce } => (number, nonce),
            _ => return Err(self.unexpected()),
        };
        let session = Session {
            key,
            role: self.hello.role,
            device_id: self.hello.device_id,
            number,
            nonce,
        };
        let first = match self.seed {
            Some(seed) => seed,
            None => {
                let mut bytes = [0; 4];
                keys::random(&mut bytes)?;
                u32::from_le_bytes(bytes)
            }
        };
        self.requester.sign(session, first);
        Ok(())
    }

    /// Asks once and waits for the answer.
    fn ask(&mut self, command: Command) -> Result<Answer> {
        self.wait_while_deaf()?;
        self.answer = None;
        let frame = self.requester.start(command, self.transport.now());
        self.transport.write_all(frame)?;
        loop {
            if let Some(answer) = self.answer.take() {
                return Ok(answer);
            }
            let now = self.transport.now();
            let wait = match self.requester.poll(now) {
                Next::Wait { until } => until.saturating_sub(now).min(GLANCE),
                Next::Send(frame) => {
                    let frame = frame.to_vec();
                    self.wait_while_deaf()?;
                    self.transport.write_all(&frame)?;
                    continue;
                }
                Next::Idle | Next::TimedOut => {
                    return Err(HostError::new(
                        ErrorCode::NoAnswer,
                        "the board does not answer; it may have done what it was asked",
                        "look at its state before asking again; check the line to the board",
                    )
                    .at(&self.name));
                }
            };
            self.poll(wait)?;
        }
    }

    fn accepted(&self, answer: Answer) -> Result<Payload> {
        match answer {
            Answer::Accepted(payload) => Ok(payload),
            Answer::Refused(refusal) => {
                let code = match refusal {
                    Refusal::KeyNeeded | Refusal::SignatureNeeded | Refusal::WrongSignature => {
                        ErrorCode::KeyNeeded
                    }
                    _ => ErrorCode::DeviceRefused,
                };
                // A refusal says what is wrong; what to do.
                let text = refusal.to_string();
                let (message, remedy) = text
                    .split_once("; ")
                    .unwrap_or((&text, "see the board's settings"));
                Err(HostError::new(code, message, remedy).at(&self.name))
            }
            Answer::Unknown => Err(HostError::new(
                ErrorCode::DeviceRefused,
                "the board does not know this command",
                "update its firmware",
            )
            .at(&self.name)),
        }
    }

    fn unexpected(&self) -> HostError {
        HostError::new(
            ErrorCode::ProtocolVersion,
            "the board's answer is of another kind than the question",
            "update the older of firmware and wimu",
        )
        .at(&self.name)
    }

    /// Which key the board has; `None` if it has none.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn key_status(&mut self) -> Result<Option<KeyId>> {
        match self.request(Command::GetKeyStatus)? {
            Payload::KeyStatus { key } => Ok(key),
            _ => Err(self.unexpected()),
        }
    }

    /// Gives the board a key, in place of the one before if it has one and this client signs with
    /// it; signs with the new one from then on, and makes sure that the board takes that. A key is
    /// never sent over a radio.
    ///
    /// # Errors
    /// `key_needed` on any link but a cable. Those of [`Client::request`]; after `verify_failed` or
    /// `no_answer` the board may have either key.
    pub fn set_key(&mut self, key: DeviceKey) -> Result<()> {
        self.only_by_cable()?;
        let outcome = self.request(Command::SetKey(key));
        // The answer may be lost and the key set: what the board holds tells.
        if let Err(error) = outcome {
            self.requester.sign_nothing();
            if self.key_status()? != Some(key.id()) {
                return Err(error);
            }
        }
        self.use_key(Some(key));
        self.open_session()?;
        if self.key_status()? == Some(key.id()) {
            Ok(())
        } else {
            Err(HostError::new(
                ErrorCode::VerifyFailed,
                "the board has another key than it was given",
                "set the key again; another computer may be setting one too",
            )
            .at(&self.name))
        }
    }

    /// Has the board forget its key: the cable writes from then on, and nobody else.
    ///
    /// # Errors
    /// As [`Client::set_key`].
    pub fn forget_key(&mut self) -> Result<()> {
        self.only_by_cable()?;
        let outcome = self.request(Command::ForgetKey);
        self.use_key(None);
        if self.key_status()?.is_none() {
            Ok(())
        } else {
            outcome.map(drop)
        }
    }

    fn only_by_cable(&self) -> Result<()> {
        if self.hello.role == LinkRole::Cable {
            return Ok(());
        }
        Err(HostError::new(
            ErrorCode::KeyNeeded,
            format!(
                "this is the {} link, and keys travel over the cable only",
                self.hello.role
            ),
            "connect the cable and name its port",
        )
        .at(&self.name))
    }

    /// The parameters in use.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn parameters(&mut self) -> Result<ActiveParameters> {
        match self.request(Command::GetParameters)? {
            Payload::Parameters(parameters) => Ok(parameters),
            _ => Err(self.unexpected()),
        }
    }

    /// The settings in use.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn settings(&mut self) -> Result<Settings> {
        match self.request(Command::GetSettings)? {
            Payload::Settings(settings) => Ok(settings),
            _ => Err(self.unexpected()),
        }
    }

    /// Stores settings on the board and has them used; returns those in use then.
    ///
    /// # Errors
    /// Those of [`Client::request`]; the nearest that the sensor can do are in the message.
    pub fn set_settings(&mut self, settings: Settings) -> Result<Settings> {
        match self.request(Command::SetSettings(settings))? {
            Payload::Settings(settings) => Ok(settings),
            _ => self.settings(),
        }
    }

    /// How the board is.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn status(&mut self) -> Result<Status> {
        match self.request(Command::GetStatus)? {
            Payload::Status(status) => Ok(status),
            _ => Err(self.unexpected()),
        }
    }

    /// Asks how the board is and does not wait: the answer is an event, and shows the board's
    /// clock. The question is filled up with zeros to the length of its answer, so that both take
    /// equally long on the line.
    ///
    /// # Errors
    /// `link_lost`.
    pub fn ask_status(&mut self) -> Result<()> {
        let now = self.transport.now();
        if now < self.deaf_until {
            return Ok(());
        }
        let frame = self.requester.start(Command::GetStatus, now);
        let mut question = vec![0; self.status_bytes.saturating_sub(frame.len())];
        question.extend_from_slice(frame);
        self.transport.write_all(&question)
    }

    /// Has the board forget parameters and settings.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn factory_reset(&mut self) -> Result<()> {
        self.request(Command::FactoryReset).map(drop)
    }

    /// Stores a calibration on the board and has it used: stages it, compares what the board
    /// staged, and commits that. A commit that is not answered, or refused, is resolved by asking
    /// what the board holds.
    ///
    /// # Errors
    /// Those of [`Client::request`]; `verify_failed` when the board holds anything else: before
    /// the commit nothing has changed on the board.
    pub fn push_parameters(&mut self, set: &ParameterSet) -> Result<ParameterId> {
        let wire = WireParameters::from(set);
        let id = parameter_id(set);
        let differs = |when: &str, found: u32| {
            HostError::new(
                ErrorCode::VerifyFailed,
                format!("{when} {found:08x}, sent were {id}"),
                "push again; if it stays so, update firmware and wimu to one version",
            )
        };
        match self.request(Command::StageParameters(wire))? {
            Payload::Staged { hash } if hash == id.0 => {}
            Payload::Staged { hash } => {
                return Err(differs("the board has staged parameters", hash).at(&self.name));
            }
            _ => return Err(self.unexpected()),
        }
        // The board has read the set back from its flash when it accepts, and it knows it by what
        // it is: the commit names it.
        let error = match self.request(Command::CommitParameters { hash: id.0 }) {
            Ok(_) => return Ok(id),
            Err(error) => error,
        };
        // The answer may be lost and the commit done, or somebody else has said that it failed:
        // what the board holds tells.
        let active = self.parameters()?;
        // Compared as numbers: −0 and 0 are one calibration, and neither is ever not-a-number.
        if active.id == id.0 && active.active == Some(wire) {
            Ok(id)
        } else {
            Err(error)
        }
    }

    /// Keeps silent while the device writes its flash: it would not hear.
    fn wait_while_deaf(&mut self) -> Result<()> {
        loop {
            let left = self.deaf_until.saturating_sub(self.transport.now());
            if left.is_zero() {
                return Ok(());
            }
            self.poll(left.min(GLANCE))?;
        }
    }

    /// Reads once.
    fn poll(&mut self, timeout: Duration) -> Result<()> {
        let mut buffer = [0; 4096];
        let count = self.transport.read(&mut buffer, timeout)?;
        let now = self.transport.now();
        let Self {
            decoder,
            requester,
            hello,
            arrivals,
            answer,
            deaf_until,
            status_bytes,
            ..
        } = self;
        let host_ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        decoder.push(host_ns, &buffer[..count], |arrival| {
            match &arrival.event {
                Event::Hello(new) => *hello = *new,
                Event::Reply { reply, body } => {
                    if let Answer::Accepted(Payload::Status(_)) = reply.answer {
                        *status_bytes = wire_length(reply);
                    }
                    if let Some(ours) = requester.on_reply(body) {
                        *answer = Some(ours);
                        // It has written, and hears again.
                        *deaf_until = Duration::ZERO;
                    }
                }
                Event::Device {
                    event: DeviceEvent::Pause { longest_ms },
                    ..
                } => *deaf_until = now + Duration::from_millis((*longest_ms).into()),
                _ => {}
            }
            arrivals.push_back(arrival);
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests;
