//! What is asked of a board, and what it answers: parameters, settings, keys.

use super::*;

/// A request is repeated in so many sessions when they end under it.
const SESSIONS: usize = 4;

impl<T: Transport> Client<T> {
    /// Signs with this key from the next write on; with none, nothing from now on.
    pub fn use_key(&mut self, key: Option<DeviceKey>) {
        self.key = key;
        self.requester.sign_nothing();
    }

    /// Signs everything from now on with the key of these that the board has, and has the board
    /// prove that it has it: what it says then, nobody else can have said. Returns whether there
    /// is one: with no keys, nothing is asked and nothing signed.
    ///
    /// # Errors
    /// `key_needed` when the board has none of them, or something else says so: who has a key of a
    /// board never goes on without. Those of [`Client::request`]; nothing has been written.
    pub fn use_key_among(&mut self, keys: &[DeviceKey]) -> Result<bool> {
        if keys.is_empty() {
            return Ok(false);
        }
        self.use_key(None);
        let held = self.key_status()?;
        let Some(ours) = keys.iter().find(|key| Some(key.id()) == held) else {
            return Err(self.not_ours(held));
        };
        self.use_key(Some(*ours));
        self.open_session()?;
        self.key_status()?;
        Ok(true)
    }

    /// Whether what is asked is signed, and what is answered therefore proved.
    pub fn signs(&self) -> bool {
        self.requester.signs()
    }

    /// The board has, or something in between says that it has, none of this computer's keys.
    fn not_ours(&self, held: Option<KeyId>) -> HostError {
        if held.is_none() && self.hello.access == WriteAccess::Locked {
            // It has one, and cannot read it.
            return self.refused(Refusal::Locked);
        }
        let (message, remedy) = match held {
            None => (
                "this computer has a key of this device, and the answer is that it has none".into(),
                "if `wimu simulate` was started without the `--store` of before, or the board's memory was erased, \
                 give it a new key over the cable with `wimu key set`; else something in between answers in its name",
            ),
            Some(id) => (
                format!("the device's key is {id}, and this computer's key of it is another"),
                "use the computer that has it, or copy its file from there; a lost key is erased at the board, \
                 and a new one given over the cable with `wimu key set`",
            ),
        };
        HostError::new(ErrorCode::KeyNeeded, message, remedy).at(&self.name)
    }

    /// Asks for something and waits for the answer, repeating the question as often as it takes.
    /// Writes are signed if there is a key, and so is everything from then on. What is asked signed
    /// is believed signed only.
    ///
    /// # Errors
    /// `device_refused` or `key_needed` with the board's reason; `no_answer` and `link_lost`, after
    /// which a write may have had its effect all the same, or have it yet. A refusal of a write that
    /// anybody can have said is no answer.
    pub fn request(&mut self, command: Command) -> Result<Payload> {
        if command.is_write() && self.key.is_some() && !self.requester.signs() {
            self.open_session()?;
        }
        let answer = self.insist(command);
        // What is staged has no effect of its own.
        let has_effect = command.is_write() && !matches!(command, Command::StageParameters(_));
        let signs = self.requester.signs();
        let certain = answer.is_ok() && (!signs || self.requester.is_authenticated());
        let nobodys = command.is_write() && !signs && self.hello.role != LinkRole::Cable;
        let outcome = match answer {
            Ok(Answer::Accepted(_)) if nobodys => Err(HostError::new(
                ErrorCode::KeyNeeded,
                "something on this link takes what nobody has signed: no wimu board does that",
                "write over the cable, or give the board a key there with `wimu key set`",
            )
            .at(&self.name)),
            answer => answer.and_then(|answer| self.accepted(answer)),
        };
        match outcome {
            Err(error) if has_effect && !certain => Err(perhaps_done(&error)),
            outcome => outcome,
        }
    }

    /// Asks, and again in other sessions when they end: the board has started anew, or that is
    /// another one's doing. What is asked for twice is done once, or is the same.
    fn insist(&mut self, command: Command) -> Result<Answer> {
        let mut answer = self.ask(command)?;
        for _ in 1..SESSIONS {
            match answer {
                Answer::Refused(Refusal::SessionEnded | Refusal::WrongSignature)
                    if self.requester.signs() =>
                {
                    self.open_session()?;
                    answer = self.ask(command)?;
                }
                _ => break,
            }
        }
        Ok(answer)
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
            None => random_number()?,
        };
        self.requester.sign(session, first);
        Ok(())
    }

    /// Asks and waits for the answer; again in another unsigned session where somebody else has used
    /// the numbers of this one. Not a write: another host's may have come between.
    fn ask(&mut self, command: Command) -> Result<Answer> {
        let mut answer = self.ask_once(command)?;
        for _ in 1..SESSIONS {
            let stale =
                answer == Answer::Refused(Refusal::Stale) && !self.requester.is_authenticated();
            if !stale || command.is_write() {
                break;
            }
            let session = match self.seed {
                Some(_) => self.requester.session().wrapping_add(1),
                None => random_number()?,
            };
            self.requester.renew(session);
            answer = self.ask_once(command)?;
        }
        Ok(answer)
    }

    /// Asks once and waits for the answer.
    fn ask_once(&mut self, command: Command) -> Result<Answer> {
        self.pauses_left = MAX_PAUSES;
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
                        "the board does not answer",
                        "check the line to the board",
                    )
                    .at(&self.name));
                }
            };
            self.poll(wait)?;
        }
    }

    pub(super) fn accepted(&self, answer: Answer) -> Result<Payload> {
        match answer {
            Answer::Accepted(payload) => Ok(payload),
            Answer::Refused(refusal) => Err(self.refused(refusal)),
            Answer::Unknown => Err(HostError::new(
                ErrorCode::DeviceRefused,
                "the board does not know this command",
                "update its firmware",
            )
            .at(&self.name)),
        }
    }

    fn refused(&self, refusal: Refusal) -> HostError {
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
        let remedy = match refusal {
            Refusal::WrongRange {
                parameters_g,
                device_g,
            } => format!(
                "if the data were taken at ±{device_g} g, calibrate again with --range {device_g} and the \
                 board's own sensitivity; if at ±{parameters_g} g, set the board to it with \
                 `wimu settings set LINK --range {parameters_g}`"
            ),
            _ => remedy.to_owned(),
        };
        HostError::new(code, message, remedy).at(&self.name)
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
        // The answer may be lost and the key set: what the board says then is proved below.
        if let Err(error) = outcome {
            self.requester.sign_nothing();
            if self.key_status().ok().flatten() != Some(key.id()) {
                return Err(error);
            }
        }
        self.use_key(Some(key));
        let held = self.open_session().and_then(|()| self.key_status());
        match held.map_err(|error| perhaps_done(&error))? {
            Some(id) if id == key.id() => Ok(()),
            _ => Err(HostError::new(
                ErrorCode::VerifyFailed,
                "the board has another key than it was given",
                "set the key again; another computer may be setting one too",
            )
            .at(&self.name)),
        }
    }

    /// Has the board forget its key: the cable writes from then on, and nobody else.
    ///
    /// # Errors
    /// As [`Client::set_key`].
    pub fn forget_key(&mut self) -> Result<()> {
        self.only_by_cable()?;
        self.request(Command::ForgetKey)?;
        self.use_key(None);
        Ok(())
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

    /// Asks for the board's time and does not wait: the answer is an event, for a
    /// [`ClockEstimator`](crate::clock::ClockEstimator). The question is filled up with zeros to the length of its answer, so that both take
    /// equally long on the line.
    ///
    /// # Errors
    /// `link_lost`.
    pub fn ask_time(&mut self) -> Result<()> {
        let now = self.transport.now();
        if now < self.deaf_until {
            return Ok(());
        }
        let frame = self.requester.start(Command::GetTime, now);
        if self.time_bytes == 0 {
            // As long as the answer will be when both have grown in the first seconds.
            self.time_bytes = frame.len() + 6;
        }
        let mut question = vec![0; self.time_bytes.saturating_sub(frame.len())];
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
        // what the board holds tells, signed if the commit was. Compared as numbers: −0 and 0 are one
        // calibration, and neither is ever not-a-number.
        match self.parameters() {
            Ok(held) if held.id == id.0 && held.active == Some(wire) => Ok(id),
            _ => Err(error),
        }
    }
}

fn random_number() -> Result<u32> {
    let mut bytes = [0; 4];
    keys::random(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// What is said when nobody knows whether a write was done.
fn perhaps_done(error: &HostError) -> HostError {
    let code = match error.code() {
        ErrorCode::LinkLost => ErrorCode::LinkLost,
        _ => ErrorCode::NoAnswer,
    };
    let perhaps = HostError::new(
        code,
        format!(
            "{}; the board may have done what it was asked, or do it yet",
            error.message()
        ),
        "look at what it holds before asking again, over the cable if you do not trust the link",
    );
    match error.location() {
        Some(location) => perhaps.at(location),
        None => perhaps,
    }
}
