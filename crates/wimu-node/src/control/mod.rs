//! Requests, parameters, settings and what is stored.

mod correction;
#[cfg(feature = "store")]
mod keys;
#[cfg(feature = "correction")]
mod parameters;
mod plan;
mod records;

use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::LinkRole;
#[cfg(feature = "auth")]
use wimu_link::auth::KeyState;
use wimu_link::frame::MAX_FRAME;
use wimu_link::message::{Answer, Command, Event, Payload, Refusal, SetBytes, Settings};
use wimu_model::{CentiCelsius, DeviceTimeUs};

use crate::sensor::{InertialSensor, Plan};
use crate::shared::{ALL, Common, Message, Orders, PersistentFault, ROLES, Worker};
use crate::slot::put;
use crate::store::{Key, Records, Store, StoreFault};
use crate::timer::Timer;

/// Longest wait for the links to send the announcement of a pause, µs.
const DRAIN_US: u64 = 100_000;
/// Interval between status messages, µs.
const STATUS_US: u64 = 5_000_000;

/// Executes requests, and stores parameters and settings.
pub struct Control<'a, A: InertialSensor, T, S, M: RawMutex> {
    pub(crate) planner: A::Planner,
    pub(crate) store: Records<S>,
    pub(crate) timer: T,
    pub(crate) shared: &'a Common<M>,
    pub(crate) orders: &'a Orders<M, A::Sample>,
    #[cfg(all(feature = "wireless", feature = "store"))]
    pub(crate) nearest_rate: Option<crate::NearestRate>,
    /// The new parameters have to be announced.
    pub(crate) parameters_changed: bool,
    pub(crate) latched: Option<CentiCelsius>,
}

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Runs for ever.
    pub async fn run(&mut self) -> ! {
        let mut plan = self.start().await;
        let mut next_status = self.timer.now();
        loop {
            self.shared.progressed(Worker::Control);
            let event = select4(
                self.shared.requests.receive(),
                self.shared.temperature.wait(),
                self.timer.until(next_status),
                self.shared.key_lost.wait(),
            );
            match event.await {
                Either4::First((role, command)) => {
                    let answer = match self.execute(&mut plan, command).await {
                        Ok(payload) => Answer::Accepted(payload),
                        Err(refusal) => Answer::Refused(refusal),
                    };
                    self.answer(role, &answer).await;
                    // After the answer, because a host waits for it and parameters are long.
                    if core::mem::take(&mut self.parameters_changed) {
                        self.announce_parameters();
                    }
                }
                #[cfg(feature = "correction")]
                Either4::Second(temperature) => self.follow_temperature(&plan, temperature).await,
                Either4::Third(()) => {
                    let now = self.timer.now();
                    next_status = DeviceTimeUs(now.0.saturating_add(STATUS_US));
                    self.send_status(now);
                }
                #[cfg(feature = "store")]
                Either4::Fourth(()) => self.forget_lost_key(&mut plan).await,
                #[cfg(not(all(feature = "correction", feature = "store")))]
                _ => {}
            }
        }
    }

    fn send_status(&self, now: DeviceTimeUs) {
        let status = Message::Status(self.shared.status(now));
        self.shared.stream(ALL, &status, |_| true);
    }

    /// Answers a request.
    async fn answer(&self, role: LinkRole, answer: &Answer) {
        let mut responder = self.shared.responder(role).await;
        let mut frame = [0; MAX_FRAME];
        match responder.is_signed() {
            true => self.shared.keep(role, responder.reply(answer, &mut frame)),
            // If there is no room, the host repeats its request.
            false => (self.shared).keep_if_room(role, responder.reply(answer, &mut frame)),
        }
    }

    /// Stores the rate of the wireless link's serial line, for the next start.
    #[cfg(all(feature = "wireless", feature = "store"))]
    async fn set_line_rate(&mut self, baud: u32) -> Result<Payload, Refusal> {
        let nearest = self.nearest_rate.ok_or(Refusal::FixedLineRate)?(baud);
        if nearest != baud {
            return Err(Refusal::UnsupportedLineRate { nearest });
        }
        self.save(Key::LineRate, &baud.to_le_bytes()).await?;
        Ok(Payload::None)
    }

    async fn execute(&mut self, plan: &mut Plan, command: Command) -> Result<Payload, Refusal> {
        match command {
            Command::GetSettings => Ok(Payload::Settings(plan.settings)),
            Command::GetKeyStatus => Ok(self.key_status()),
            #[cfg(feature = "auth")]
            Command::SetKey(key) => self.set_key(key).await,
            #[cfg(feature = "auth")]
            Command::ForgetKey => self.forget_key().await,
            Command::GetTime => Ok(Payload::Time { uptime_us: self.timer.now().0 }),
            Command::GetStatus => Ok(Payload::Status(self.shared.status(self.timer.now()))),
            #[cfg(feature = "correction")]
            Command::GetParameters => Ok(Payload::Parameters(self.shared.active())),
            #[cfg(feature = "correction")]
            Command::SetParameters(set) => {
                self.set_parameters(plan, &set).await.map(|()| Payload::None)
            }
            Command::SetSettings(wanted) => {
                let new = plan::or_refusal(&self.planner, &wanted)?;
                self.change(plan, new).await?;
                Ok(Payload::Settings(plan.settings))
            }
            #[cfg(all(feature = "wireless", feature = "store"))]
            Command::SetLineRate { baud } => self.set_line_rate(baud).await,
            Command::FactoryReset => {
                let new = plan::nearest(&self.planner, &Settings::default())
                    .ok_or(Refusal::SensorFailed)?;
                self.configure(&new, &SetBytes::NONE).await?;
                self.announce_pause().await;
                if let Err(StoreFault) = self.store.remove(is_calibration_or_settings).await {
                    self.configure(plan, &self.shared.active()).await?;
                    return Err(Refusal::StoreFailed);
                }
                put(plan, &new);
                self.activate(&SetBytes::NONE);
                self.shared.publish(|published| published.settings = new.settings);
                self.clear_fault(PersistentFault::Settings);
                self.clear_fault(PersistentFault::Parameters);
                self.announce(&Message::Settings(new.settings));
                self.announce_parameters();
                Ok(Payload::None)
            }
            // Not among the features of this node, or answered before.
            _ => Err(Refusal::NotSupported),
        }
    }

    fn key_status(&self) -> Payload {
        #[cfg(feature = "auth")]
        if let KeyState::Set(key) = self.shared.lock().key {
            return Payload::KeyStatus { key: Some(key.id()) };
        }
        Payload::KeyStatus { key: None }
    }

    /// Announces that nothing is received while the flash is written, and waits until the announcement is
    /// sent, for at most [`DRAIN_US`] because a link may be stalled.
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

    /// Applies new settings and stores them. On failure the old ones stay in use.
    async fn change(&mut self, plan: &mut Plan, new: Plan) -> Result<(), Refusal> {
        let before = self.shared.parameters();
        let other_range = new.settings.range_g != plan.settings.range_g;
        let set = if other_range {
            self.load_parameters(new.settings.range_g)
        } else {
            self.shared.active()
        };
        self.configure(&new, &set).await?;
        let mut bytes = [0; Settings::MAX_BYTES];
        let length = new.settings.to_bytes(&mut bytes);
        if let Err(refusal) = self.save(Key::Settings, &bytes[..length]).await {
            self.configure(plan, &self.shared.active()).await?;
            return Err(refusal);
        }
        put(plan, &new);
        self.shared.publish(|published| published.settings = new.settings);
        self.clear_fault(PersistentFault::Settings);
        self.announce(&Message::Settings(new.settings));
        if other_range {
            self.activate(&set);
        }
        if self.shared.parameters() != before {
            self.announce_parameters();
        }
        Ok(())
    }

    fn announce_parameters(&self) {
        for role in ROLES {
            self.shared.send_parameters(role);
        }
    }

    fn announce(&self, message: &Message) {
        self.shared.announce(message, ALL);
    }

    fn set_fault(&self, fault: PersistentFault, event: Event) {
        self.shared.set_fault(fault, self.timer.now(), Some(event));
    }

    fn clear_fault(&self, fault: PersistentFault) {
        self.shared.set_fault(fault, self.timer.now(), None);
    }
}

fn is_calibration_or_settings(key: Key) -> bool {
    matches!(key, Key::Parameters { .. } | Key::Settings)
}
