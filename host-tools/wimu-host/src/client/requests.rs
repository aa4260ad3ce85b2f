//! Requests to a board: parameters, settings, keys.

use std::ops::RangeInclusive;

use wimu_link::hello::{Capabilities, sensor};
use wimu_link::message::SetBytes;
use wimu_model::{CompiledSet, Sensitivity, SensorId};

use super::*;
use crate::LinkUrl;
use crate::calibration::compiled_for;
use crate::calibration::source::{self, ActiveParameters};
use crate::keys::KeyFolder;

/// Largest number of sessions in which a request is repeated when they end.
const SESSIONS: usize = 4;
/// Allowed ratio of a calibration's sensitivity to the sensor's nominal one: covers the tolerance of a sensor, excludes
/// another range.
const SENSITIVITY_RATIO: RangeInclusive<f64> = 0.8..=1.25;
/// The same of a calibration that does not name its sensor, whose sensitivity may be a guess: nominal ones are equal.
const SAME_SENSITIVITY: RangeInclusive<f64> = 0.999..=1.001;
/// Longest wait for an epoch: a device that samples sends one a second.
const EPOCH_PATIENCE: Duration = Duration::from_secs(3);

impl<T: Transport> Client<T> {
    /// Signs with this key from the next write on; with `None`, signs nothing.
    pub fn use_key(&mut self, key: Option<DeviceKey>) {
        self.key = key;
        self.requester.sign_nothing();
    }

    /// Signs everything from now on with that of `keys` which the board has, and verifies a signed answer
    /// of the board. Returns whether there is a key: with no keys, nothing is requested or signed.
    ///
    /// # Errors
    /// `key_needed` when the board has none of them, or something else answers so: with a key of a
    /// board, the host never continues without it. Those of [`Client::request`]; nothing has been written.
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

    /// The same with the keys that this computer has of the board. A board that is reached by its name in a fleet must be
    /// the device that it was the first time.
    ///
    /// # Errors
    /// Those of [`KeyFolder::candidates`], [`KeyFolder::recognise`] and [`Client::use_key_among`].
    pub fn use_own_key(&mut self) -> Result<bool> {
        let (folder, device) = (KeyFolder::of_user()?, self.hello.device_id);
        let by_name = matches!(self.name.parse(), Ok(LinkUrl::Mqtt { .. }));
        if by_name {
            folder.recognise(&self.name, device, false)?;
        }
        let signs = self.use_key_among(&folder.candidates(device)?)?;
        if by_name {
            folder.recognise(&self.name, device, signs)?;
        }
        Ok(signs)
    }

    /// Whether requests are signed, and answers therefore verified.
    pub fn signs(&self) -> bool {
        self.requester.signs()
    }

    /// The error for a board that has, or appears to have, none of this computer's keys.
    fn not_ours(&self, held: Option<KeyId>) -> Problem {
        if held.is_none() && self.hello.access == WriteAccess::Locked {
            // It has a key that it cannot read.
            return self.refused(Refusal::Locked);
        }
        let (message, remedy) = match held {
            None => (
                "this computer has a key of this device, but the device answers that it has none"
                    .into(),
                "if `wimu simulate` was started without its `--store`, or the board's memory was erased, set a new key over the \
             cable with `wimu device key set`; else something in between is answering",
            ),
            Some(id) => (
                format!("the device's key is {id}, this computer has another one"),
                "use the computer with that key, or copy its file; erase a lost key at the board and set a new one over the \
                 cable with `wimu device key set`",
            ),
        };
        Code::KeyNeeded.error(message, remedy).at(&self.name)
    }

    /// Sends a request and waits for the answer, repeating it if necessary. Writes are signed if there
    /// is a key, and so is everything from then on. Answers to signed requests are accepted only if signed.
    ///
    /// # Errors
    /// `device_refused` or `key_needed` with the board's reason; `no_answer` and `link_lost`, after
    /// which a write may still have been executed. An unsigned refusal of a write does not count as an answer.
    pub fn request(&mut self, command: Command) -> Result<Payload> {
        let is_verified = self.requester.signs() && self.requester.is_authenticated();
        if command.is_write() && self.key.is_some() && !is_verified {
            self.open_session()?;
            // With another key than the board's nothing is written.
            self.key_status()?;
        }
        let answer = self.insist(command);
        let signs = self.requester.signs();
        let certain = answer.is_ok() && (!signs || self.requester.is_authenticated());
        // No board obeys it.
        let unsigned_write = command.is_write() && !signs && self.hello.role != LinkRole::Cable;
        let has_effect = command.is_write() && !unsigned_write;
        let outcome = match answer {
            Ok(Answer::Accepted(_)) if unsigned_write => Err(Code::KeyNeeded.error("an unsigned write was accepted on this link: the answer is not from a wimu board",
                "write over the cable, or set a key there with `wimu device key set`",
            )
            .at(&self.name)),
            answer => answer.and_then(|answer| self.accepted(answer)),
        };
        match outcome {
            // It has not left this computer.
            Err(error) if error.code == Code::NotThroughBroker => Err(error),
            Err(error) if has_effect && !certain => Err(possibly_done(&error)),
            outcome => outcome,
        }
    }

    /// Sends a request, and again in new sessions when they end: the board restarted, or another host
    /// interfered. Every request has the same effect once or twice.
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

    /// Opens a session on the board; requests are signed in it from now on.
    fn open_session(&mut self) -> Result<()> {
        let Some(key) = self.key else {
            return Ok(());
        };
        let answer = self.ask(Command::OpenSession)?;
        let (number, nonce) = match self.accepted(answer)? {
            Payload::Session { number, nonce } => (number, nonce),
            _ => return Err(self.unexpected()),
        };
        let session =
            Session { key, role: self.hello.role, device_id: self.hello.device_id, number, nonce };
        let first = match self.seed {
            Some(seed) => seed,
            None => random_number()?,
        };
        self.requester.sign(session, first);
        Ok(())
    }

    /// Sends a request and waits for the answer; again in another unsigned session where another host has used
    /// the numbers of this one. Writes are not repeated: another host's may have come between.
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

    /// Sends a request once and waits for the answer.
    fn ask_once(&mut self, command: Command) -> Result<Answer> {
        self.pauses_left = MAX_PAUSES;
        self.wait_while_deaf()?;
        self.answer = None;
        let frame = self.requester.start(command, self.transport.now()).to_vec();
        self.send(&frame)?;
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
                    self.send(&frame)?;
                    continue;
                }
                Next::Idle | Next::TimedOut => {
                    return Err(Code::NoAnswer
                        .error("the board does not answer", "check the line to the board")
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
            Answer::Unknown => Err(Code::DeviceRefused
                .error("the board does not know this command", "update its firmware")
                .at(&self.name)),
        }
    }

    fn refused(&self, refusal: Refusal) -> Problem {
        let code = match refusal {
            Refusal::KeyNeeded | Refusal::SignatureNeeded | Refusal::WrongSignature => {
                Code::KeyNeeded
            }
            _ => Code::DeviceRefused,
        };
        // A refusal's text is the cause, then the remedy.
        let text = refusal.to_string();
        let (message, remedy) =
            text.split_once("; ").unwrap_or((&text, "see the board's settings"));
        let remedy = match refusal {
            Refusal::WrongRange {
                parameters_g,
                device_g,
            } => format!(
                "for data taken at ±{device_g} g, calibrate again with --range {device_g} and the board's own sensitivity; for data \
                 at ±{parameters_g} g, set the board with `wimu device settings set LINK --range {parameters_g}`"
            ),
            Refusal::InvalidParameters(_) if !text.contains("; ") => {
                "calibrate this board (`wimu calibrate LINK --push`), or push a calibration made for its sensor".to_owned()
            }
            _ => remedy.to_owned(),
        };
        code.error(message, remedy).at(&self.name)
    }

    fn unexpected(&self) -> Problem {
        Code::ProtocolVersion
            .error(
                "the board's answer does not match the request",
                "update the older of firmware and wimu",
            )
            .at(&self.name)
    }

    /// Id of the board's key; `None` if it has none.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn key_status(&mut self) -> Result<Option<KeyId>> {
        match self.request(Command::GetKeyStatus)? {
            Payload::KeyStatus { key } => Ok(key),
            _ => Err(self.unexpected()),
        }
    }

    /// Sets the board's key, replacing an existing one if this client signs with
    /// it; signs with the new one from then on, and verifies that the board accepts that. A key is
    /// never sent over a radio link.
    ///
    /// # Errors
    /// `key_needed` on any link but a cable. Those of [`Client::request`]; after `verify_failed` or
    /// `no_answer` the board may have either key.
    pub fn set_key(&mut self, key: DeviceKey) -> Result<()> {
        self.only_by_cable()?;
        let outcome = self.request(Command::SetKey(key));
        // The answer may be lost although the key was set: verified below.
        if let Err(error) = outcome {
            self.requester.sign_nothing();
            if self.key_status().ok().flatten() != Some(key.id()) {
                return Err(error);
            }
        }
        self.use_key(Some(key));
        let held = self.open_session().and_then(|()| self.key_status());
        match held.map_err(|error| possibly_done(&error))? {
            Some(id) if id == key.id() => Ok(()),
            _ => Err(Code::VerifyFailed
                .error(
                    "the board has a key other than the one that was set",
                    "set the key again; another computer may be setting one too",
                )
                .at(&self.name)),
        }
    }

    /// Erases the board's key: from then on only the cable can write.
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
        Err(Code::KeyNeeded
            .error(
                format!(
                    "this is the {} link, and keys are sent over the cable only",
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
        let Payload::Parameters(bytes) = self.request(Command::GetParameters)? else {
            return Err(self.unexpected());
        };
        bytes.set().map(ActiveParameters::new).map_err(|_| self.unexpected())
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

    /// Stores settings on the board and applies them; returns those then in use.
    ///
    /// # Errors
    /// Those of [`Client::request`]; the message has the nearest settings that the sensor supports.
    pub fn set_settings(&mut self, settings: Settings) -> Result<Settings> {
        // Another range has other scales.
        self.nominal = None;
        match self.request(Command::SetSettings(settings))? {
            Payload::Settings(settings) => Ok(settings),
            _ => self.settings(),
        }
    }

    /// Stores the rate of the board's wireless serial line, bit/s, at which it opens the line from its next start on.
    ///
    /// # Errors
    /// Those of [`Client::request`]; `device_refused` when the board has no such line, or with the nearest rate that the
    /// line supports.
    pub fn set_line_rate(&mut self, baud: u32) -> Result<()> {
        self.request(Command::SetLineRate { baud }).map(drop)
    }

    /// The board's status.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn status(&mut self) -> Result<Status> {
        match self.request(Command::GetStatus)? {
            Payload::Status(status) => Ok(status),
            _ => Err(self.unexpected()),
        }
    }

    /// Requests the board's time without waiting: the answer is an event, for a
    /// [`ClockEstimator`](crate::clock::ClockEstimator). The request is padded with zeros to the length of its answer,
    /// so that both take equally long on the line. Returns the time before sending, ns, and the data; `None` while the
    /// device does not receive.
    ///
    /// # Errors
    /// `link_lost`.
    pub fn ask_time(&mut self) -> Result<Option<(u64, Vec<u8>)>> {
        let now = self.transport.now();
        if now < self.deaf_until {
            return Ok(None);
        }
        let frame = self.requester.start(Command::GetTime, now);
        if self.time_bytes == 0 {
            // The length that the answer will have after the first seconds.
            self.time_bytes = frame.len() + 6;
        }
        let mut question = vec![0; self.time_bytes.saturating_sub(frame.len())];
        question.extend_from_slice(frame);
        Ok(Some((self.send(&question)?, question)))
    }

    /// Erases parameters and settings of the board.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn factory_reset(&mut self) -> Result<()> {
        self.request(Command::FactoryReset).map(drop)
    }

    /// Compiles a calibration for the board, stores it there and applies it. If that is not answered, or refused, the
    /// parameters that the board holds decide.
    ///
    /// # Errors
    /// Those of [`Client::request`]; `device_refused` when it is not for the board's sensor or cannot be compiled, and
    /// `no_answer` when a board with a gyroscope does not report its scale: nothing has been sent then.
    pub fn push_parameters(&mut self, set: &ParameterSet) -> Result<ParameterId> {
        let compiled = self.compiled(set)?;
        self.store(set, &compiled)
    }

    fn store(&mut self, set: &ParameterSet, compiled: &CompiledSet) -> Result<ParameterId> {
        source::learn(set);
        // When the board accepts, it has read the set back from its flash.
        let error = match self.request(Command::SetParameters(SetBytes::from(compiled))) {
            Ok(_) => return Ok(compiled.source()),
            Err(error) => error,
        };
        if !self.requester.signs() && self.hello.role != LinkRole::Cable {
            return Err(error);
        }
        // The answer may be lost although it was done, or a forged refusal: the parameters that the board holds decide,
        // signed if the request was.
        match self.parameters() {
            Ok(held) if held.active == Some(*compiled) => Ok(compiled.source()),
            _ => Err(error),
        }
    }

    /// Waits for an epoch of a board with a gyroscope: one without a calibration of its own gets an ideal one of the nominal
    /// scale, because it is rotated to the body with the accelerometer.
    fn wait_for_scales(&mut self) -> Result<()> {
        let until = self.transport.now() + EPOCH_PATIENCE;
        while self.nominal.is_none() {
            if self.transport.now() >= until {
                return Err(Code::NoAnswer
                    .error(
                        "the board does not report the scale of its gyroscope",
                        "check that its sensor runs: `wimu monitor LINK`",
                    )
                    .at(&self.name));
            }
            self.poll(GLANCE)?;
        }
        Ok(())
    }

    /// A calibration in integers for the board, if it is for its sensor.
    fn compiled(&mut self, set: &ParameterSet) -> Result<CompiledSet> {
        if set.gyroscope.is_none() && self.hello.capabilities.contains(Capabilities::GYROSCOPE) {
            self.wait_for_scales()?;
        }
        let refused = |why: String, remedy: &str| {
            Code::DeviceRefused.error(why, remedy.to_owned()).at(&self.name)
        };
        let again = "calibrate from this board's own recording";
        if set.sensor_index != 0 {
            let why = format!(
                "the parameters are for sensor {} of a board, which corrects its sensor 0",
                set.sensor_index
            );
            return Err(refused(why, "push those of sensor 0"));
        }
        let device = self.hello.sensor.number;
        if let Some(SensorId(number)) = set.sensor
            && number != device
            && sensor::is_one_model(device)
        {
            let [theirs, ours] = [number, device].map(sensor::name);
            return Err(refused(
                format!("the parameters are for the {theirs}, the board has the {ours}"),
                again,
            ));
        }
        let allowed = if set.sensor.is_some() { SENSITIVITY_RATIO } else { SAME_SENSITIVITY };
        if let Some((lsb_per_g, _)) = self.nominal
            && self.hello.sensitivity_known
            && !allowed.contains(&(set.sensitivity.lsb_per_g() / lsb_per_g))
        {
            let why = format!(
                "the parameters are for {:.1} LSB/g, the sensor has {lsb_per_g} LSB/g",
                set.sensitivity.lsb_per_g()
            );
            let remedy = format!(
                "set the range at which it was calibrated, or calibrate at this one; a file of this sensor: --sensitivity {lsb_per_g}"
            );
            return Err(refused(why, &remedy));
        }
        let has = |part| self.hello.capabilities.contains(part);
        let has_gyroscope = has(Capabilities::GYROSCOPE);
        let heard = self.nominal.and_then(|(_, gyroscope)| gyroscope);
        let own = set.gyroscope.map(|known| known.rad_s_per_lsb);
        let gyroscope = heard.or(own).filter(|_| has_gyroscope);
        if let Some((found, nominal)) = own.zip(gyroscope)
            && !SENSITIVITY_RATIO.contains(&(found / nominal))
        {
            let why = format!(
                "the gyroscope's parameters are for {found} rad/s per LSB, the sensor has {nominal}"
            );
            return Err(refused(why, again));
        }
        let magnetometer =
            has(Capabilities::MAGNETOMETER) && has(Capabilities::HEADING) && !has_gyroscope;
        compiled_for(set, self.hello.device_id, gyroscope, magnetometer).map_err(|error| {
            refused(format!("the parameters are invalid: {error}"), "calibrate again")
        })
    }

    /// Stores a calibration as [`Client::push_parameters`] does, verifies that the device holds its integers, and keeps it
    /// on this computer.
    ///
    /// # Errors
    /// Those of [`Client::push_parameters`]; `verify_failed` when the device holds others.
    pub fn push_verified(&mut self, set: &ParameterSet) -> Result<ParameterId> {
        let compiled = self.compiled(set)?;
        let id = self.store(set, &compiled)?;
        let found = self.parameters().map_err(|error| {
            let message =
                format!("the device accepted {id}, but verifying it failed: {}", error.text);
            error.code.error(message, error.remedy).at(&self.name)
        })?;
        if found.active != Some(compiled) {
            let held = if found.id == id.0 {
                format!("the device holds other integers of {id} than were pushed")
            } else {
                format!("the device holds parameters {:08x} instead of the pushed {id}", found.id)
            };
            return Err(Code::VerifyFailed
                .error(held, "push again; another computer may have pushed at the same time")
                .at(&self.name));
        }
        // A computer that cannot keep it has still pushed it: the board's integers remain.
        let _ = source::keep(set);
        Ok(id)
    }

    /// The calibration that the device holds, with its id; `None` if it is uncalibrated.
    ///
    /// # Errors
    /// Those of [`Client::parameters`]; `verify_failed` when it is invalid.
    pub fn held_parameters(&mut self) -> Result<Option<(ParameterId, ParameterSet)>> {
        let nominal =
            self.nominal.and_then(|(lsb_per_g, _)| Sensitivity::from_lsb_per_g(lsb_per_g).ok());
        let reported = self.parameters()?;
        let held = reported.calibration(nominal).map_err(|fault| {
            Code::VerifyFailed.error(
                format!("the device holds invalid parameters: {fault}"),
                "calibrate and push again",
            )
        })?;
        Ok(held.map(|set| (ParameterId(reported.id), set)))
    }
}

fn random_number() -> Result<u32> {
    let mut bytes = [0; 4];
    keys::random(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// The error when it is unknown whether a write was done.
fn possibly_done(error: &Problem) -> Problem {
    let code = match error.code {
        Code::LinkLost => Code::LinkLost,
        _ => Code::NoAnswer,
    };
    let message = match error.code {
        Code::KeyNeeded | Code::DeviceRefused => format!(
            "no authenticated answer was received ({}): the request may have been executed, or may still be",
            error.text
        ),
        _ => format!("{}; the request may have been executed, or may still be", error.text),
    };
    let remedy =
        "check the board's state before repeating it, over the cable if the link is not trusted";
    Problem { place: error.place.clone(), ..code.error(message, remedy) }
}
