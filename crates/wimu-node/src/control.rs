//! Requests, parameters, settings and what is stored.

use core::marker::PhantomData;

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::batch::MAX_BATCH;
use wimu_link::frame::{self, MAX_FRAME};
use wimu_link::message::{
    ActiveParameters, Answer, Command, Event, ParameterFault, Payload, Refusal, Settings, Streams,
    Telemetry, parameter_id,
};
use wimu_link::{Deframer, Kind};
use wimu_model::{CentiCelsius, CompileError, Corrector, DeviceTimeUs, ParameterId, ParameterSet};

use crate::accelerometer::{Accelerometer, Plan};
use crate::shared::{Correction, Order, ROLES, Shared, Trouble};
use crate::store::{Key, MAX_RECORD, Store, StoreFault};
use crate::timer::Timer;

/// The corrector is compiled anew when the temperature has moved this far.
const TEMPERATURE_STEP: i16 = 50;
/// Sensitivity of a parameter set against the sensor's own: what a user may have measured, no
/// other range and no other sensor.
const SENSITIVITY_RATIO: core::ops::RangeInclusive<f64> = 0.8..=1.25;
/// How the device is, is told this often.
const STATUS_US: u64 = 5_000_000;

/// Obeys requests, keeps parameters and settings.
pub struct Control<'a, A, T, S, M: RawMutex> {
    pub(crate) store: S,
    pub(crate) timer: T,
    pub(crate) shared: &'a Shared<M>,
    pub(crate) staged: Option<ParameterSet>,
    pub(crate) latched: Option<CentiCelsius>,
    pub(crate) sensor: PhantomData<A>,
}

impl<A: Accelerometer, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Runs for ever.
    pub async fn run(mut self) -> ! {
        let mut plan = self.start().await;
        let mut next_status = self.timer.now();
        loop {
            let event = select3(
                self.shared.requests.receive(),
                self.shared.temperature.wait(),
                self.timer.until(next_status),
            )
            .await;
            match event {
                Either3::First((role, command)) => {
                    let answer = match self.obey(&mut plan, command).await {
                        Ok(payload) => Answer::Accepted(payload),
                        Err(refusal) => Answer::Refused(refusal),
                    };
                    let mut frame = [0; MAX_FRAME];
                    let length = self.shared.with_inbox(role, |inbox| {
                        let reply = inbox.responder.reply(&answer);
                        match frame.get_mut(..reply.len()) {
                            Some(room) => room.copy_from_slice(reply),
                            None => return 0,
                        }
                        reply.len()
                    });
                    self.shared
                        .keep(role, frame.get(..length).unwrap_or_default());
                }
                Either3::Second(temperature) => self.follow(&plan, temperature).await,
                Either3::Third(()) => {
                    let now = self.timer.now();
                    next_status = DeviceTimeUs(now.0.saturating_add(STATUS_US));
                    let mut frame = [0; MAX_FRAME];
                    let status = Telemetry::Status(self.shared.status(now));
                    if let Ok(length) = status.encode(&mut frame) {
                        let frame = frame.get(..length).unwrap_or_default();
                        self.shared.stream([true; 2], frame, |_| true);
                    }
                }
            }
        }
    }

    /// Reads what is stored and starts the sensor. What cannot be read or used is reported, and
    /// the device runs without it.
    async fn start(&mut self) -> Plan {
        let boot_count = match self.load_boot_count().await {
            Ok(before) => {
                let count = before.wrapping_add(1).max(1);
                if self.save_boot_count(count).await.is_err() {
                    self.trouble(Trouble::BootCount, Event::StoreUnreadable);
                }
                count
            }
            Err(StoreFault) => {
                self.trouble(Trouble::BootCount, Event::StoreUnreadable);
                0
            }
        };
        let wanted = match self.load(Key::Settings).await {
            Ok(Some(Telemetry::Settings(settings))) => settings,
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
        self.shared.publish(|published| {
            published.hello.boot_count = boot_count;
            published.settings = plan.settings;
            published.parameters = parameters;
            published.ready = true;
        });
        for role in ROLES {
            self.shared.introduce(role, self.timer.now());
        }
        // A sensor that does not start is reported and tried again by the sampler.
        let _ = self.configure(&plan, parameters.as_ref()).await;
        plan
    }

    /// The set committed for a range. What cannot be read or used is reported.
    async fn load_parameters(&mut self, range_g: u8) -> Option<ParameterSet> {
        match self.load(Key::Parameters { range_g }).await {
            Ok(None) => {
                self.mended(Trouble::Parameters);
                None
            }
            Ok(Some(Telemetry::Parameters(ActiveParameters {
                active: Some(stored),
                ..
            }))) if stored.range_g == range_g => match ParameterSet::try_from(&stored) {
                Ok(set) => {
                    self.mended(Trouble::Parameters);
                    Some(set)
                }
                Err(fault) => {
                    self.trouble(Trouble::Parameters, Event::ModelRejected(fault));
                    None
                }
            },
            _ => {
                self.trouble(Trouble::Parameters, Event::StoreUnreadable);
                None
            }
        }
    }

    async fn obey(&mut self, plan: &mut Plan, command: Command) -> Result<Payload, Refusal> {
        match command {
            Command::GetParameters => Ok(self.active()),
            Command::GetSettings => Ok(Payload::Settings(plan.settings)),
            Command::SetLineRate { .. } => Err(Refusal::FixedLineRate),
            Command::GetStatus => Ok(Payload::Status(self.shared.status(self.timer.now()))),
            Command::StageParameters(wire) => {
                let set = ParameterSet::try_from(&wire).map_err(Refusal::InvalidParameters)?;
                if set.range_g != plan.settings.range_g {
                    return Err(Refusal::WrongRange {
                        parameters_g: set.range_g,
                        device_g: plan.settings.range_g,
                    });
                }
                Corrector::compile(&set, self.latched)
                    .map_err(|fault| Refusal::InvalidParameters(fault.into()))?;
                let ratio = set.sensitivity.lsb_per_g() / plan.sensitivity.lsb_per_g();
                let known = self.shared.published().hello.sensitivity_known;
                if known && !SENSITIVITY_RATIO.contains(&ratio) {
                    return Err(Refusal::WrongSensitivity {
                        parameters_lsb_per_g: set.sensitivity.lsb_per_g(),
                        device_lsb_per_g: plan.sensitivity.lsb_per_g(),
                    });
                }
                self.staged = Some(set);
                Ok(Payload::Staged {
                    hash: parameter_id(&set).0,
                })
            }
            Command::CommitParameters { hash } => self.commit(ParameterId(hash)).await,
            Command::SetSettings(wanted) => {
                let new = plan_of::<A>(&wanted)?;
                self.change(plan, new).await?;
                Ok(Payload::Settings(plan.settings))
            }
            Command::FactoryReset => {
                let new = plan_nearest::<A>(&Settings::default()).ok_or(Refusal::SensorFailed)?;
                self.configure(&new, None).await?;
                if let Err(StoreFault) = self.store.remove(is_calibration_or_settings).await {
                    let committed = self.shared.published().parameters;
                    self.configure(plan, committed.as_ref()).await?;
                    return Err(Refusal::StoreFailed);
                }
                *plan = new;
                self.staged = None;
                self.shared.publish(|published| {
                    published.settings = new.settings;
                    published.parameters = None;
                });
                for mended in [Trouble::Settings, Trouble::Parameters] {
                    self.mended(mended);
                }
                self.announce(&Telemetry::Settings(new.settings));
                self.announce_parameters();
                Ok(Payload::None)
            }
        }
    }

    async fn commit(&mut self, named: ParameterId) -> Result<Payload, Refusal> {
        let Some(staged) = self.staged else {
            // Whoever commits again what is in use has lost our answer.
            return if self.shared.published().parameter_id() == named {
                Ok(self.active())
            } else {
                Err(Refusal::NothingStaged)
            };
        };
        let id = parameter_id(&staged);
        if id != named {
            return Err(Refusal::HashMismatch { staged: id.0 });
        }
        let correction = self
            .compile(&staged, id)
            .map_err(|fault| Refusal::InvalidParameters(fault.into()))?;
        let record = Telemetry::Parameters(ActiveParameters {
            active: Some((&staged).into()),
            id: id.0,
        });
        let key = Key::Parameters {
            range_g: staged.range_g,
        };
        self.save(key, &record).await?;
        self.staged = None;
        self.shared
            .publish(|published| published.parameters = Some(staged));
        self.mended(Trouble::Parameters);
        self.shared.orders.send(Order::Correct(correction)).await;
        self.announce_parameters();
        Ok(self.active())
    }

    /// Runs the sensor under new settings and stores them; on failure it runs as before.
    async fn change(&mut self, plan: &mut Plan, new: Plan) -> Result<(), Refusal> {
        let before = self.shared.published().parameters;
        let parameters = if new.settings.range_g == plan.settings.range_g {
            before
        } else {
            self.load_parameters(new.settings.range_g).await
        };
        let record = Telemetry::Settings(new.settings);
        let mut outcome = self.configure(&new, parameters.as_ref()).await;
        if outcome.is_ok() {
            outcome = self.save(Key::Settings, &record).await;
            if outcome.is_err() {
                self.configure(plan, before.as_ref()).await?;
            }
        }
        outcome?;
        *plan = new;
        self.shared.publish(|published| {
            published.settings = new.settings;
            published.parameters = parameters;
        });
        self.mended(Trouble::Settings);
        self.announce(&record);
        if parameters != before {
            self.announce_parameters();
        }
        Ok(())
    }

    async fn configure(
        &mut self,
        plan: &Plan,
        committed: Option<&ParameterSet>,
    ) -> Result<(), Refusal> {
        let correction = self
            .correction(plan, committed)
            .map_err(|fault| Refusal::InvalidParameters(fault.into()))?;
        self.shared.configured.reset();
        self.shared
            .orders
            .send(Order::Configure(*plan, correction))
            .await;
        self.shared
            .configured
            .wait()
            .await
            .map_err(|_| Refusal::SensorFailed)
    }

    /// Compiles the corrector anew when the temperature has moved by a step.
    async fn follow(&mut self, plan: &Plan, temperature: CentiCelsius) {
        let moved = self
            .latched
            .is_none_or(|latched| latched.0.abs_diff(temperature.0) >= TEMPERATURE_STEP as u16);
        if moved {
            self.latched = Some(temperature);
            let committed = self.shared.published().parameters;
            if let Ok(correction) = self.correction(plan, committed.as_ref()) {
                self.shared.orders.send(Order::Correct(correction)).await;
            }
        }
    }

    /// The corrector for `plan`: of the committed parameters if they are for its range, else of a
    /// perfect sensor.
    fn correction(
        &self,
        plan: &Plan,
        committed: Option<&ParameterSet>,
    ) -> Result<Correction, CompileError> {
        let range_g = plan.settings.range_g;
        if let Some(set) = committed.filter(|set| set.range_g == range_g) {
            match self.compile(set, parameter_id(set)) {
                Ok(correction) => {
                    self.mended(Trouble::Parameters);
                    return Ok(correction);
                }
                Err(fault) => {
                    let event = Event::ModelRejected(ParameterFault::from(fault));
                    self.trouble(Trouble::Parameters, event);
                    self.shared.report(self.timer.now(), event);
                }
            }
        }
        let uncalibrated = ParameterSet::uncalibrated(range_g, plan.sensitivity);
        self.compile(&uncalibrated, ParameterId::UNCALIBRATED)
    }

    fn compile(
        &self,
        set: &ParameterSet,
        parameters: ParameterId,
    ) -> Result<Correction, CompileError> {
        Ok(Correction {
            corrector: Corrector::compile(set, self.latched)?,
            parameters,
            temperature: self.latched,
        })
    }

    fn active(&self) -> Payload {
        Payload::Parameters(self.shared.published().active())
    }

    fn announce_parameters(&self) {
        self.announce(&Telemetry::Parameters(self.shared.published().active()));
    }

    fn announce(&self, message: &Telemetry) {
        self.shared.announce(message, [true; 2]);
    }

    fn trouble(&self, trouble: Trouble, event: Event) {
        self.shared.trouble(trouble, self.timer.now(), Some(event));
    }

    fn mended(&self, trouble: Trouble) {
        self.shared.trouble(trouble, self.timer.now(), None);
    }

    /// Reads a record; one that is damaged counts as unreadable memory.
    async fn load(&mut self, key: Key) -> Result<Option<Telemetry>, StoreFault> {
        let mut record = [0; MAX_RECORD];
        let Some(length) = self.store.load(key, &mut record).await? else {
            return Ok(None);
        };
        let mut deframer = Deframer::new();
        let record = record.get(..length).unwrap_or_default();
        let message = record.iter().find_map(|&byte| match deframer.push(byte) {
            Some(Ok(frame)) if frame.kind == Kind::Telemetry => Telemetry::decode(frame.body).ok(),
            _ => None,
        });
        message.map(Some).ok_or(StoreFault)
    }

    async fn save(&mut self, key: Key, record: &Telemetry) -> Result<(), Refusal> {
        let mut bytes = [0; MAX_RECORD];
        let length = record
            .encode(&mut bytes)
            .map_err(|_| Refusal::StoreFailed)?;
        self.store
            .save(key, bytes.get(..length).unwrap_or_default())
            .await
            .map_err(|StoreFault| Refusal::StoreFailed)
    }

    async fn load_boot_count(&mut self) -> Result<u32, StoreFault> {
        let mut record = [0; MAX_RECORD];
        let Some(length) = self.store.load(Key::BootCount, &mut record).await? else {
            return Ok(0);
        };
        let mut deframer = Deframer::new();
        let record = record.get(..length).unwrap_or_default();
        record
            .iter()
            .find_map(|&byte| {
                let frame = deframer.push(byte)?.ok()?;
                Some(u32::from_le_bytes(frame.body.try_into().ok()?))
            })
            .ok_or(StoreFault)
    }

    async fn save_boot_count(&mut self, count: u32) -> Result<(), StoreFault> {
        let mut bytes = [0; MAX_RECORD];
        let length = frame::encode(Kind::Telemetry, &count.to_le_bytes(), &mut bytes)
            .map_err(|_| StoreFault)?;
        self.store
            .save(Key::BootCount, bytes.get(..length).unwrap_or_default())
            .await
    }
}

fn is_calibration_or_settings(key: Key) -> bool {
    matches!(key, Key::Parameters { .. } | Key::Settings)
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
