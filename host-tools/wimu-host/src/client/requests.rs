//! What is asked of a board, and what it answers: parameters, settings, keys.

use super::*;

/// A request is repeated in so many sessions when they end under it.
const SESSIONS: usize = 4;

impl<T: Transport> Client<T> {
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

    pub(super) fn accepted(&self, answer: Answer) -> Result<Payload> {
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
        // what the board holds tells.
        let active = self.parameters()?;
        // Compared as numbers: −0 and 0 are one calibration, and neither is ever not-a-number.
        if active.id == id.0 && active.active == Some(wire) {
            Ok(id)
        } else {
            Err(error)
        }
    }
}
