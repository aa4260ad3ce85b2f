//! Requests, parameters, settings and what is stored.

use core::marker::PhantomData;
use core::ops::Range;

use embassy_futures::select::{Either, Either4, select, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_integrator::Compass;
use wimu_link::auth::{DeviceKey, KeyState};
use wimu_link::batch::MAX_BATCH;
use wimu_link::frame::{self, MAX_FRAME};
use wimu_link::hello::sensor;
use wimu_link::message::{
    ActiveParameters, Answer, Command, EncodedParameters, Event, ParameterFault, Payload, Record,
    Refusal, Settings, Streams, WireParameters,
};
use wimu_link::{Kind, LinkRole, Responder};
use wimu_model::{
    CentiCelsius, CompileError, Corrector, DeviceTimeUs, ParameterId, ParameterSet, SensorId,
};

use crate::accelerometer::{Accelerometer, Plan};
use crate::shared::{
    Correction, Message, Order, ROLES, RateOrder, Shared, Staged, Trouble, active_parameters,
};
use crate::slot::put;
use crate::store::{Key, MAX_RECORD, Store, StoreFault};
use crate::timer::Timer;

/// The corrector is compiled anew when the temperature has moved this far.
const TEMPERATURE_STEP: i16 = 50;
/// Sensitivity of a parameter set against the sensor's own: what a user may have measured, no
/// other range and no other sensor.
const SENSITIVITY_RATIO: core::ops::RangeInclusive<f64> = 0.8..=1.25;
/// A link is given so long to carry the announcement of a pause.
const DRAIN_US: u64 = 100_000;
/// How the device is, is told this often.
const STATUS_US: u64 = 5_000_000;

/// Records other than parameter sets have room here.
const SHORT_RECORD: usize = 64;

/// What is answered to a request other than for the parameters.
type ShortPayload = Payload<EncodedParameters<'static>>;

/// Obeys requests, keeps parameters and settings.
pub struct Control<'a, A, T, S, M: RawMutex> {
    pub(crate) store: S,
    pub(crate) timer: T,
    pub(crate) shared: &'a Shared<M>,
    /// A record on its way to the store or from it.
    pub(crate) record: [u8; MAX_RECORD],
    /// The hosts are to be told.
    pub(crate) parameters_changed: bool,
    #[cfg(feature = "self-check")]
    pub(crate) self_check: crate::self_check::Keeper,
    pub(crate) latched: Option<CentiCelsius>,
    pub(crate) sensor: PhantomData<A>,
}

impl<A: Accelerometer, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Runs for ever.
    pub async fn run(&mut self) -> ! {
        let mut plan = self.start().await;
        let mut next_status = self.timer.now();
        loop {
            let event = select(
                select4(
                    self.shared.requests.receive(),
                    self.shared.temperature.wait(),
                    self.timer.until(next_status),
                    self.shared.key_lost.wait(),
                ),
                select(self.shared.rates.receive(), self.shared.rest.wait()),
            )
            .await;
            let event = match event {
                Either::First(event) => event,
                Either::Second(Either::First((role, baud))) => {
                    // What cannot be stored holds until the next start.
                    let _ = self.save_rate(role, baud).await;
                    continue;
                }
                #[cfg(feature = "self-check")]
                Either::Second(Either::Second((mean, parameters))) => {
                    self.check(mean, parameters);
                    continue;
                }
                #[cfg(not(feature = "self-check"))]
                Either::Second(Either::Second(_)) => continue,
            };
            match event {
                Either4::First((role, Command::SetLineRate { link, baud })) => {
                    let outcome = self.set_rate(role, link, baud).await;
                    let answer = match outcome {
                        Ok(_) => Answer::Accepted(Payload::None),
                        Err(refusal) => Answer::Refused(refusal),
                    };
                    self.answer(role, Some(&answer)).await;
                    // The answer leaves at the old rate.
                    if let Ok((line, order)) = outcome {
                        self.shared.rate_signals(line).order.signal(order);
                    }
                }
                Either4::First((role, Command::GetParameters)) => self.answer(role, None).await,
                Either4::First((role, command)) => {
                    let answer = match self.obey(&mut plan, role, command).await {
                        Ok(payload) => Answer::Accepted(payload),
                        Err(refusal) => Answer::Refused(refusal),
                    };
                    self.answer(role, Some(&answer)).await;
                    // Behind the answer: they are long, and somebody waits for it.
                    if core::mem::take(&mut self.parameters_changed) {
                        self.announce_parameters();
                    }
                }
                Either4::Second(temperature) => self.follow(&plan, temperature).await,
                Either4::Third(()) => {
                    let now = self.timer.now();
                    next_status = DeviceTimeUs(now.0.saturating_add(STATUS_US));
                    self.tell_status(now);
                }
                Either4::Fourth(()) => self.lose_key(&mut plan).await,
            }
        }
    }

    fn tell_status(&self, now: DeviceTimeUs) {
        let status = Message::Status(self.shared.status(now));
        self.shared.stream([true; 2], &status, |_| true);
    }

    /// Answers a request; with the parameters in use where there is no other answer.
    async fn answer(&self, role: LinkRole, answer: Option<&Answer<EncodedParameters<'_>>>) {
        let mut responder = self.shared.responder(role).await;
        match answer {
            Some(answer) => self.reply(role, &mut responder, answer),
            None => {
                let active = self.shared.active();
                let active = Payload::Parameters(active_parameters(&active));
                self.reply(role, &mut responder, &Answer::Accepted(active));
            }
        }
    }

    fn reply(
        &self,
        role: LinkRole,
        responder: &mut Responder,
        answer: &Answer<EncodedParameters<'_>>,
    ) {
        let mut frame = [0; MAX_FRAME];
        match responder.is_signed() {
            true => self.shared.keep(role, responder.reply(answer, &mut frame)),
            // One that finds no room is asked for again.
            false => (self.shared).keep_if_room(role, responder.reply(answer, &mut frame)),
        }
    }

    /// What is to become of a line's rate because of a request on the link `role`.
    async fn set_rate(
        &mut self,
        role: LinkRole,
        link: u8,
        baud: u32,
    ) -> Result<(LinkRole, RateOrder), Refusal> {
        let line = ROLES.into_iter().find(|role| role.number() == link);
        let line = line.ok_or(Refusal::FixedLineRate)?;
        match self.shared.nearest_rate(line, baud) {
            None => Err(Refusal::FixedLineRate),
            Some(_) if (role, line) == (LinkRole::Wireless, LinkRole::Wireless) => {
                Err(Refusal::AdapterLineRate)
            }
            Some(nearest) if nearest != baud => Err(Refusal::UnsupportedLineRate { nearest }),
            Some(_) if role == line => Ok((line, RateOrder::Try(baud))),
            Some(_) => {
                self.save_rate(line, baud).await?;
                Ok((line, RateOrder::Use(Some(baud))))
            }
        }
    }

    async fn save_rate(&mut self, line: LinkRole, baud: u32) -> Result<(), Refusal> {
        self.announce_pause().await;
        let saved = self.save_raw(rate_key(line), &baud.to_le_bytes()).await;
        saved.map_err(|_| Refusal::StoreFailed)
    }

    /// Reads what is stored and starts the sensor. What cannot be read or used is reported, and
    /// the device runs without it.
    async fn start(&mut self) -> Plan {
        let mut bytes = [0; 4];
        let boot_count = match self.load_raw(Key::BootCount, &mut bytes).await {
            // A count that is not kept would come again.
            Ok(_) => self.count_start(u32::from_le_bytes(bytes)).await,
            Err(StoreFault) => None,
        };
        if boot_count.is_none() {
            self.trouble(Trouble::BootCount, Event::StoreUnreadable);
        }
        let mut key = [0; DeviceKey::LENGTH];
        let key = match self.load_raw(Key::DeviceKey, &mut key).await {
            Ok(false) => KeyState::None,
            Ok(true) => KeyState::Set(DeviceKey::new(key)),
            Err(StoreFault) => {
                self.trouble(Trouble::DeviceKey, Event::StoreUnreadable);
                KeyState::Unreadable
            }
        };
        let loaded = self.load(Key::Settings).await;
        let wanted = match loaded.map(|place| place.map(|at| Record::decode(self.content(&at)))) {
            Ok(Some(Ok(Record::Settings(settings)))) => settings,
            Ok(None) => Settings::default(),
            _ => {
                self.trouble(Trouble::Settings, Event::StoreUnreadable);
                Settings::default()
            }
        };
        let plan = match plan::<A>(&wanted) {
            Ok(plan) => Some(plan),
            Err(nearest) => {
                self.trouble(Trouble::Settings, Event::SettingsAdjusted);
                plan::<A>(&nearest).ok()
            }
        };
        // A sensor has at least one way to run.
        let plan = match plan.or_else(|| plan_nearest::<A>(&Settings::default())) {
            Some(plan) => plan,
            None => core::future::pending().await,
        };
        let parameters = self.load_parameters(plan.settings.range_g).await;
        self.shared.activate(self.set_at(&parameters));
        self.shared.publish(|published| {
            published.hello.boot_count = boot_count.unwrap_or(0);
            published.lock.boot_count = boot_count;
            published.lock.key = key;
            published.settings = plan.settings;
            published.ready = true;
        });
        for role in ROLES {
            let stored = self.load_raw(rate_key(role), &mut bytes).await == Ok(true);
            let baud = u32::from_le_bytes(bytes);
            let order = RateOrder::Use(stored.then_some(baud));
            self.shared.rate_signals(role).order.signal(order);
            self.shared.introduce(role, self.timer.now());
        }
        // A sensor that does not start is reported and tried again by the sampler.
        let _ = self.configure(&plan, None).await;
        plan
    }

    /// The set committed for a range: where in the record it is. What cannot be read or used is
    /// reported.
    async fn load_parameters(&mut self, range_g: u8) -> Option<Range<usize>> {
        let loaded = self.load(Key::Parameters { range_g }).await;
        let place = match loaded {
            Ok(place) => place,
            Err(StoreFault) => {
                self.trouble(Trouble::Parameters, Event::StoreUnreadable);
                return None;
            }
        };
        let fault = match place
            .clone()
            .map(|place| Record::decode(self.content(&place)))
        {
            None => None,
            Some(Ok(Record::Parameters(stored))) => match stored.decode() {
                Ok(wire) if wire.range_g == range_g => {
                    let set = self.checked(&wire);
                    set.err().map(Event::ModelRejected)
                }
                _ => Some(Event::StoreUnreadable),
            },
            Some(_) => Some(Event::StoreUnreadable),
        };
        let now = self.timer.now();
        self.shared.trouble(Trouble::Parameters, now, fault);
        if fault.is_some() { None } else { place }
    }

    /// The set of a record of parameters at a place.
    fn set_at(&self, place: &Option<Range<usize>>) -> Option<EncodedParameters<'_>> {
        match Record::decode(self.content(place.as_ref()?)) {
            Ok(Record::Parameters(set)) => Some(set),
            _ => None,
        }
    }

    /// A set whose numbers make sense, and that is of this device's model of accelerometer.
    fn checked(&self, wire: &WireParameters) -> Result<ParameterSet, ParameterFault> {
        let set = ParameterSet::try_from(wire)?;
        let device = self
            .shared
            .with_published(|published| published.hello.sensor.number);
        match set.sensor {
            Some(SensorId(parameters)) if parameters != device && sensor::is_one_model(device) => {
                Err(ParameterFault::OtherSensor { parameters, device })
            }
            _ => Ok(set),
        }
    }

    /// What is in a record that has been opened: the first byte says what it is.
    fn content(&self, place: &Range<usize>) -> &[u8] {
        self.record.get(place.clone()).unwrap_or_default()
    }

    async fn obey(
        &mut self,
        plan: &mut Plan,
        role: LinkRole,
        command: Command<()>,
    ) -> Result<ShortPayload, Refusal> {
        match command {
            // Answered before it comes here.
            Command::GetParameters => Ok(Payload::None),
            Command::GetSettings => Ok(Payload::Settings(plan.settings)),
            // Answered before it comes here.
            Command::SetLineRate { .. } => Err(Refusal::FixedLineRate),
            Command::GetKeyStatus => Ok(self.key_status()),
            // Answered before it comes here.
            Command::OpenSession => Err(Refusal::KeyNeeded),
            Command::SetKey(key) => self.set_key(key).await,
            Command::ForgetKey => {
                self.announce_pause().await;
                let removed = self.store.remove(|key| key == Key::DeviceKey).await;
                removed.map_err(|StoreFault| Refusal::StoreFailed)?;
                self.take_key(KeyState::None);
                Ok(self.key_status())
            }
            Command::GetTime => Ok(Payload::Time {
                uptime_us: self.timer.now().0,
            }),
            Command::GetStatus => Ok(Payload::Status(self.shared.status(self.timer.now()))),
            Command::StageParameters(()) => {
                let mut desk = self.shared.desk.lock().await;
                let id = self.judge(plan, role, &mut desk)?;
                desk.id = Some(id);
                Ok(Payload::Staged { hash: id.0 })
            }
            Command::CommitParameters { hash } => self.commit(ParameterId(hash)).await,
            Command::SetSettings(wanted) => {
                let new = plan_of::<A>(&wanted)?;
                self.change(plan, new).await?;
                Ok(Payload::Settings(plan.settings))
            }
            Command::FactoryReset => {
                let new = plan_nearest::<A>(&Settings::default()).ok_or(Refusal::SensorFailed)?;
                self.configure(&new, Some(&None)).await?;
                self.announce_pause().await;
                if let Err(StoreFault) = self.store.remove(is_calibration_or_settings).await {
                    self.configure(plan, None).await?;
                    return Err(Refusal::StoreFailed);
                }
                put(plan, &new);
                self.shared.desk.lock().await.id = None;
                self.shared.activate(None);
                self.shared
                    .publish(|published| published.settings = new.settings);
                for mended in [Trouble::Settings, Trouble::Parameters] {
                    self.mended(mended);
                }
                self.announce(&Message::Settings(new.settings));
                self.announce_parameters();
                Ok(Payload::None)
            }
        }
    }

    /// Checks the set that came on a link; the desk holds it in its one true form then.
    #[inline(never)] // The decoded set leaves the stack with it.
    fn judge(
        &self,
        plan: &Plan,
        role: LinkRole,
        desk: &mut Staged,
    ) -> Result<ParameterId, Refusal> {
        // Another host's has taken its place before it was looked at.
        if desk.from.as_ref() != Some(&role) {
            return Err(Refusal::NothingStaged);
        }
        desk.from.take();
        let wire = desk.set.get().and_then(|set| set.decode().ok());
        let mut wire = wire.ok_or(Refusal::NothingStaged)?;
        let set = self.checked(&wire).map_err(Refusal::InvalidParameters)?;
        wire.take_rotations(&set);
        if set.range_g != plan.settings.range_g {
            return Err(Refusal::WrongRange {
                parameters_g: set.range_g,
                device_g: plan.settings.range_g,
            });
        }
        Corrector::compile(&set, self.latched).map_err(invalid)?;
        let ratio = set.sensitivity.lsb_per_g() / plan.sensitivity.lsb_per_g();
        let known = (self.shared).with_published(|published| published.hello.sensitivity_known);
        if known && !SENSITIVITY_RATIO.contains(&ratio) {
            return Err(Refusal::WrongSensitivity {
                parameters_lsb_per_g: set.sensitivity.lsb_per_g(),
                device_lsb_per_g: plan.sensitivity.lsb_per_g(),
            });
        }
        Ok(desk.set.encode(&wire))
    }

    /// Compares a rest with what the parameters promise, and reports if they no longer hold.
    #[cfg(feature = "self-check")]
    fn check(&mut self, mean: [i64; 3], parameters: ParameterId) {
        let published = self.shared.published();
        if published.parameters != parameters {
            return;
        }
        let gravity_um_s2 = published.settings.gravity_um_s2;
        let active = self.shared.active();
        let wire = active.get().and_then(|set| set.decode().ok());
        let set = wire.and_then(|wire| ParameterSet::try_from(&wire).ok());
        let set = set.map(|set| (parameters, set));
        match self
            .self_check
            .rest(set.as_ref(), gravity_um_s2, self.latched, mean)
        {
            crate::self_check::Verdict::Contradicted(event) => {
                self.trouble(Trouble::Calibration, event);
                self.shared.report(self.timer.now(), event);
            }
            crate::self_check::Verdict::Holds => self.mended(Trouble::Calibration),
            crate::self_check::Verdict::Unknown => {}
        }
    }

    /// Takes the owner's word that the key is lost: no more key, and settings as from the factory.
    async fn lose_key(&mut self, plan: &mut Plan) {
        self.announce_pause().await;
        let removed = self
            .store
            .remove(|key| matches!(key, Key::DeviceKey | Key::Settings))
            .await;
        if removed.is_err() {
            self.shared.report(self.timer.now(), Event::StoreUnreadable);
            return;
        }
        if let Some(new) = plan_nearest::<A>(&Settings::default()) {
            let parameters = self.load_parameters(new.settings.range_g).await;
            // A sensor that is away is started with these settings when it is back.
            let _ = self.configure(&new, Some(&parameters)).await;
            put(plan, &new);
            self.shared.activate(self.set_at(&parameters));
            self.shared
                .publish(|published| published.settings = new.settings);
            self.mended(Trouble::Settings);
        }
        self.take_key(KeyState::None);
    }

    /// Stores a key and takes it. With another key, the starts are counted anew if they could not
    /// be read: no session of before is one of now.
    async fn set_key(&mut self, key: DeviceKey) -> Result<ShortPayload, Refusal> {
        self.announce_pause().await;
        self.save_raw(Key::DeviceKey, key.expose())
            .await
            .map_err(|StoreFault| Refusal::StoreFailed)?;
        let lock = self.shared.lock();
        if lock.boot_count.is_none() && lock.key != KeyState::Set(key) {
            let boot_count = self.count_start(0).await;
            self.shared.publish(|published| {
                published.hello.boot_count = boot_count.unwrap_or(0);
                published.lock.boot_count = boot_count;
            });
            if boot_count.is_some() {
                self.mended(Trouble::BootCount);
            }
        }
        self.take_key(KeyState::Set(key));
        Ok(self.key_status())
    }

    /// From now on writes are signed with this key, and hosts are told.
    fn take_key(&mut self, key: KeyState) {
        self.shared.publish(|published| published.lock.key = key);
        self.mended(Trouble::DeviceKey);
        for role in ROLES {
            self.shared.introduce(role, self.timer.now());
        }
    }

    fn key_status(&self) -> ShortPayload {
        Payload::KeyStatus {
            key: match self.shared.lock().key {
                KeyState::Set(key) => Some(key.id()),
                _ => None,
            },
        }
    }

    /// Tells the hosts that nothing is heard for a while, and waits until they know: at most a
    /// tenth of a second, for a link may have stalled.
    async fn announce_pause(&self) {
        let longest_ms = self.store.pause_ms();
        if longest_ms == 0 {
            return;
        }
        let now = self.timer.now();
        self.shared.report(now, Event::Pause { longest_ms });
        let until = now.0.saturating_add(DRAIN_US);
        while !ROLES.iter().all(|role| self.shared.is_drained(*role)) && self.timer.now().0 < until
        {
            self.timer.after_us(500).await;
        }
    }

    async fn commit(&mut self, named: ParameterId) -> Result<ShortPayload, Refusal> {
        let shared = self.shared;
        let mut desk = shared.desk.lock().await;
        let Staged { set, id, .. } = &mut *desk;
        let (Some(staged), Some(set)) = (*id, set.get()) else {
            // Whoever commits again what is in use has lost our answer.
            return if shared.parameters() == named {
                Ok(Payload::None)
            } else {
                Err(Refusal::NothingStaged)
            };
        };
        if staged != named {
            return Err(Refusal::HashMismatch { staged: staged.0 });
        }
        let range_g = self.compiled(set)?.1;
        let length = parameters_record(set, &mut self.record);
        self.announce_pause().await;
        self.save_record(Key::Parameters { range_g }, length)
            .await?;
        shared.activate(Some(set));
        *id = None;
        self.parameters_changed = true;
        self.mended(Trouble::Parameters);
        shared.orders.room().await;
        let correction = self.compiled(set)?.0;
        shared.orders.give(Order::Correct(correction));
        Ok(Payload::None)
    }

    /// Runs the sensor under new settings and stores them; on failure it runs as before.
    async fn change(&mut self, plan: &mut Plan, new: Plan) -> Result<(), Refusal> {
        let before = self.shared.parameters();
        let other_range = new.settings.range_g != plan.settings.range_g;
        let mut loaded = None;
        if other_range {
            loaded = self.load_parameters(new.settings.range_g).await;
        }
        let with = other_range.then_some(&loaded);
        self.configure(&new, with).await?;
        if let Err(refusal) = self.save_settings(new.settings).await {
            self.configure(plan, None).await?;
            return Err(refusal);
        }
        put(plan, &new);
        self.shared
            .publish(|published| published.settings = new.settings);
        self.mended(Trouble::Settings);
        self.announce(&Message::Settings(new.settings));
        if other_range {
            // What is staged is for the range before.
            self.shared.desk.lock().await.id = None;
            self.shared.activate(self.set_at(&loaded));
        }
        if self.shared.parameters() != before {
            self.announce_parameters();
        }
        Ok(())
    }

    /// Has the sensor run under `plan`, corrected with the set in use, or with that at a place in the
    /// record, or with none there.
    async fn configure(
        &mut self,
        plan: &Plan,
        with: Option<&Option<Range<usize>>>,
    ) -> Result<(), Refusal> {
        self.shared.orders.room().await;
        self.shared.configured.reset();
        let correction = match with {
            None => self.correction_in_use(plan)?,
            Some(place) => self.correction(plan, self.set_at(place))?,
        };
        self.shared.orders.give(Order::Configure(*plan, correction));
        let outcome = self.shared.configured.wait().await;
        outcome.map_err(|_| Refusal::SensorFailed)
    }

    /// Compiles the corrector anew when the temperature has moved by a step.
    async fn follow(&mut self, plan: &Plan, temperature: CentiCelsius) {
        let moved = self
            .latched
            .is_none_or(|latched| latched.0.abs_diff(temperature.0) >= TEMPERATURE_STEP as u16);
        if moved {
            self.latched = Some(temperature);
            self.shared.orders.room().await;
            if let Ok(correction) = self.correction_in_use(plan) {
                self.shared.orders.give(Order::Correct(correction));
            }
        }
    }

    /// The corrector for `plan` with the set in use.
    fn correction_in_use(&self, plan: &Plan) -> Result<Correction, Refusal> {
        self.correction(plan, self.shared.active().get())
    }

    /// The corrector for `plan`: of the committed parameters if they are for its range, else of a
    /// perfect sensor.
    fn correction(
        &self,
        plan: &Plan,
        committed: Option<EncodedParameters>,
    ) -> Result<Correction, Refusal> {
        let range_g = plan.settings.range_g;
        if let Some(set) = committed {
            match self.compiled(set) {
                Ok((correction, of)) if of == range_g => {
                    self.mended(Trouble::Parameters);
                    return Ok(correction);
                }
                Err(Refusal::InvalidParameters(fault)) => {
                    let event = Event::ModelRejected(fault);
                    self.trouble(Trouble::Parameters, event);
                    self.shared.report(self.timer.now(), event);
                }
                _ => {}
            }
        }
        let uncalibrated = ParameterSet::uncalibrated(range_g, plan.sensitivity);
        self.compile(&uncalibrated, ParameterId::UNCALIBRATED)
    }

    /// The corrector of a set, and the range that it is for.
    fn compiled(&self, set: EncodedParameters) -> Result<(Correction, u8), Refusal> {
        let wire = set.decode().map_err(|_| Refusal::NothingStaged)?;
        let decoded = ParameterSet::try_from(&wire).map_err(Refusal::InvalidParameters)?;
        Ok((self.compile(&decoded, set.id())?, decoded.range_g))
    }

    fn compile(&self, set: &ParameterSet, parameters: ParameterId) -> Result<Correction, Refusal> {
        Ok(Correction {
            corrector: Corrector::compile(set, self.latched).map_err(invalid)?,
            parameters,
            temperature: self.latched,
            compass: if A::MAGNETOMETER {
                Compass::new(set)
            } else {
                None
            },
        })
    }

    fn announce_parameters(&self) {
        for role in ROLES {
            self.shared.tell_parameters(role);
        }
    }

    fn announce(&self, message: &Message) {
        self.shared.announce(message, [true; 2]);
    }

    fn trouble(&self, trouble: Trouble, event: Event) {
        self.shared.trouble(trouble, self.timer.now(), Some(event));
    }

    fn mended(&self, trouble: Trouble) {
        self.shared.trouble(trouble, self.timer.now(), None);
    }

    /// Reads a record: where in `record` its content is. One that is damaged counts as unreadable
    /// memory.
    async fn load(&mut self, key: Key) -> Result<Option<Range<usize>>, StoreFault> {
        let Some(length) = self.store.load(key, &mut self.record).await? else {
            return Ok(None);
        };
        let record = self.record.get_mut(..length).unwrap_or_default();
        let opened = frame::open(record).map_err(|_| StoreFault)?;
        Ok(Some(0..opened))
    }

    async fn save_settings(&mut self, settings: Settings) -> Result<(), Refusal> {
        let mut record = [0; SHORT_RECORD];
        let length = settings_record(settings, &mut record);
        self.announce_pause().await;
        let record = record.get(..length).unwrap_or_default();
        let saved = self.store.save(Key::Settings, record).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    async fn save_record(&mut self, key: Key, length: usize) -> Result<(), Refusal> {
        let record = self.record.get(..length).unwrap_or_default();
        let saved = self.store.save(key, record).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    /// Counts one more start; `None` if it cannot be kept.
    async fn count_start(&mut self, before: u32) -> Option<u32> {
        let count = before.wrapping_add(1).max(1);
        let saved = self.save_raw(Key::BootCount, &count.to_le_bytes()).await;
        saved.is_ok().then_some(count)
    }

    /// Reads a record of bytes into `bytes`; whether there is one.
    async fn load_raw(&mut self, key: Key, bytes: &mut [u8]) -> Result<bool, StoreFault> {
        let Some(place) = self.load(key).await? else {
            return Ok(false);
        };
        match self.content(&place).split_first() {
            Some((_, stored)) if stored.len() == bytes.len() => bytes.copy_from_slice(stored),
            _ => return Err(StoreFault),
        }
        Ok(true)
    }

    async fn save_raw(&mut self, key: Key, content: &[u8]) -> Result<(), StoreFault> {
        let mut record = [0; SHORT_RECORD];
        let length = frame::encode(Kind::Telemetry, content, &mut record);
        let length = length.map_err(|_| StoreFault)?;
        let record = record.get(..length).unwrap_or_default();
        self.store.save(key, record).await
    }
}

// Not async, so that no task has room for the messages while it waits. Both fit.

fn parameters_record(set: EncodedParameters, record: &mut [u8]) -> usize {
    let parameters = ActiveParameters {
        active: Some(set),
        id: set.id().0,
    };
    Message::Parameters(parameters).encode(record).unwrap_or(0)
}

fn settings_record(settings: Settings, record: &mut [u8]) -> usize {
    Message::Settings(settings).encode(record).unwrap_or(0)
}

/// The set does not compile.
fn invalid(fault: CompileError) -> Refusal {
    Refusal::InvalidParameters(fault.into())
}

fn is_calibration_or_settings(key: Key) -> bool {
    matches!(key, Key::Parameters { .. } | Key::Settings)
}

fn rate_key(line: LinkRole) -> Key {
    match line {
        LinkRole::Cable => Key::CableRate,
        _ => Key::WirelessRate,
    }
}

/// How the sensor will run under `wanted`, or the nearest that the device can do.
fn plan<A: Accelerometer>(wanted: &Settings) -> Result<Plan, Settings> {
    let streams = |streams: Streams| Streams {
        batch: streams.batch.clamp(1, MAX_BATCH as u8),
        every: streams.every.max(1),
        ..streams
    };
    let possible = Settings {
        gravity_um_s2: wanted.gravity_um_s2.clamp(9_700_000, 9_900_000),
        cable: streams(wanted.cable),
        wireless: streams(wanted.wireless),
        ..*wanted
    };
    A::plan(&possible).and_then(|plan| {
        if possible == *wanted {
            Ok(plan)
        } else {
            Err(possible)
        }
    })
}

fn plan_of<A: Accelerometer>(wanted: &Settings) -> Result<Plan, Refusal> {
    plan::<A>(wanted).map_err(|nearest| Refusal::UnsupportedSettings { nearest })
}

fn plan_nearest<A: Accelerometer>(wanted: &Settings) -> Option<Plan> {
    plan::<A>(wanted)
        .or_else(|nearest| plan::<A>(&nearest))
        .ok()
}
