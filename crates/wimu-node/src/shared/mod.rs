//! What the node's tasks share.

mod orders;
mod sending;

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::mutex::{MappedMutexGuard, Mutex as AsyncMutex, MutexGuard};
use embassy_sync::signal::Signal;
use wimu_link::auth::Lock;
use wimu_link::message::{Command, Event, SensorStatus, SetBytes, Settings, StackStatus};
use wimu_link::{Hello, LinkRole, Responder};
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, ParameterId};

pub(crate) use self::orders::{Correction, Order, Orders};

use crate::queue::FrameQueue;
use crate::sample::RawSample;
use crate::sensor::SensorFault;
use crate::slot::Slot;

pub(crate) use wimu_link::message::Telemetry as Message;

/// The links: both, or without the feature `wireless` the cable.
#[cfg(feature = "wireless")]
pub(crate) const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];
#[cfg(not(feature = "wireless"))]
pub(crate) const ROLES: [LinkRole; 1] = [LinkRole::Cable];

/// The number of links: 2, or without the feature `wireless` 1. A board needs no tasks for the others.
pub const LINKS: usize = ROLES.len();

/// One value for each link, in the order of [`ROLES`].
pub(crate) type Roles<T = bool> = [T; ROLES.len()];
pub(crate) const ALL: Roles = [true; _];
pub(crate) const NONE: Roles = [false; _];

/// Whether the link of this role is one of [`ROLES`]. The tasks of another do nothing.
pub(crate) fn runs(role: LinkRole) -> bool {
    ROLES.contains(&role)
}

/// Memory that a node's tasks share. Put it in a `static` or where it outlives them.
///
/// `M` is `CriticalSectionRawMutex` if the sampler runs at a higher interrupt priority than the other
/// tasks, `NoopRawMutex` if one executor polls all tasks. `S` is the sensor's
/// [`Sample`](crate::InertialSensor::Sample).
pub struct Shared<M: RawMutex, S: RawSample = Counts> {
    pub(crate) common: Common<M>,
    pub(crate) orders: Orders<M, S>,
}

impl<M: RawMutex, S: RawSample> Shared<M, S> {
    /// Memory for one node. Its initial value is all zeros, so that a `static` takes no flash.
    pub const fn new() -> Self {
        Self { common: Common::new(), orders: Orders::new() }
    }

    /// Makes the device forget its key and its settings, but not its calibration. A board calls it after a
    /// gesture that takes physical access, such as a button held down for seconds: the owner has lost
    /// the key.
    pub fn forget_key(&self) {
        self.common.key_lost.signal(());
    }

    /// Reports on both links that the button was pressed, for the `count`-th time.
    pub fn mark(&self, now: DeviceTimeUs, count: u16) {
        self.common.report(now, Event::Marked { count });
    }

    /// Summary of the device's state, for its indicator.
    pub fn health(&self) -> Health {
        self.common.health()
    }

    /// How often each task has gone around its loop, modulo 2³²: the sampler, the control task, the writer of the cable,
    /// the writer of the wireless link. A working sampler goes around within four sample periods, restarts of a failed
    /// sensor aside; the others within 5 s, changes of the store and frames longer than that aside. A link that this build
    /// does not have counts as the control task does.
    pub fn progress(&self) -> [u32; 4] {
        let progress = self.common.progress.each_ref();
        let mut progress = progress.map(|turns| turns.load(Ordering::Relaxed));
        for (link, role) in [(2, LinkRole::Cable), (3, LinkRole::Wireless)] {
            if !runs(role) {
                progress[link] = progress[1];
            }
        }
        progress
    }

    /// Reports the use of the stack in the next status.
    pub fn report_stack(&self, stack: StackStatus) {
        self.common.publish(|published| published.stack = Some(stack));
    }
}

impl<M: RawMutex, S: RawSample> Default for Shared<M, S> {
    fn default() -> Self {
        Self::new()
    }
}

/// A task that counts its turns.
#[derive(Clone, Copy)]
pub(crate) enum Worker {
    Sampler,
    Control,
    Writer(LinkRole),
}

/// Memory of all tasks, whatever the sensor.
pub(crate) struct Common<M: RawMutex> {
    /// In the order of [`Shared::progress`].
    progress: [AtomicU32; 4],
    links: Roles<LinkShared<M>>,
    pub(crate) configured: Signal<M, Result<(), SensorFault>>,
    pub(crate) temperature: Signal<M, CentiCelsius>,
    /// Accepted requests.
    pub(crate) requests: Channel<M, (LinkRole, Command), 1>,
    /// The parameter set in use.
    active: Mutex<M, RefCell<SetBytes>>,
    pub(crate) key_lost: Signal<M, ()>,
    /// Empty until something is published.
    published: Mutex<M, RefCell<Slot<Published>>>,
}

struct LinkShared<M: RawMutex> {
    outbox: Mutex<M, RefCell<FrameQueue>>,
    waiting: Signal<M, ()>,
    /// Empty until the first request. Computing signatures takes long, so this lock does not disable
    /// interrupts, which would delay sample times.
    responder: AsyncMutex<M, Slot<Responder>>,
    heard: Mutex<M, Cell<Heard>>,
}

impl<M: RawMutex> LinkShared<M> {
    const fn new() -> Self {
        Self {
            outbox: Mutex::new(RefCell::new(FrameQueue::new())),
            waiting: Signal::new(),
            responder: AsyncMutex::new(Slot::Empty),
            heard: Mutex::new(Cell::new(Heard::NOTHING)),
        }
    }
}

/// The state of the receiving side of a link.
#[derive(Clone, Copy)]
pub(crate) struct Heard {
    /// Damaged frames.
    pub(crate) damaged: u32,
    /// Repeated requests.
    pub(crate) repeated: u32,
    /// The link needs an epoch: it has a new listener, or frames were dropped.
    epoch_wanted: bool,
    /// The parameters in use have to be sent, as soon as there is room.
    parameters_wanted: bool,
}

impl Heard {
    const NOTHING: Self =
        Self { damaged: 0, repeated: 0, epoch_wanted: false, parameters_wanted: false };
}

/// Persistent faults of a device.
#[derive(Clone, Copy)]
pub(crate) enum PersistentFault {
    Sensor,
    BootCount,
    Settings,
    Parameters,
    DeviceKey,
}

impl PersistentFault {
    /// The number of variants.
    const COUNT: usize = 5;
}

/// Summary of the device's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Health {
    /// Samples read since the start, modulo 2³².
    pub samples: u32,
    /// The sensor has failed and is being restarted.
    pub sensor_lost: bool,
    /// Parameters are in use.
    pub calibrated: bool,
    /// Frames dropped because a link was too slow, modulo 2³².
    pub shed: u32,
}

/// The present state of the device.
#[derive(Clone, Copy)]
pub(crate) struct Published {
    pub(crate) hello: Hello,
    /// Decides who may write.
    pub(crate) lock: Lock,
    pub(crate) settings: Settings,
    /// The parameters in use.
    pub(crate) parameters: ParameterId,
    pub(crate) sensor: SensorStatus,
    pub(crate) measured_period_ns: Option<u32>,
    pub(crate) jitter_ns: Option<u32>,
    stack: Option<StackStatus>,
    /// Present faults by [`PersistentFault`], and when each began.
    faults: [Option<(DeviceTimeUs, Event)>; PersistentFault::COUNT],
    /// Whether the store has been read; before that nothing is sent.
    pub(crate) ready: bool,
}

impl Published {
    fn new() -> Self {
        Self {
            hello: Hello::new(LinkRole::Cable),
            lock: Lock::default(),
            settings: Settings::default(),
            parameters: ParameterId::UNCALIBRATED,
            sensor: SensorStatus::default(),
            measured_period_ns: None,
            jitter_ns: None,
            stack: None,
            faults: [None; PersistentFault::COUNT],
            ready: false,
        }
    }
}

impl<M: RawMutex> Common<M> {
    const fn new() -> Self {
        Self {
            progress: [const { AtomicU32::new(0) }; 4],
            links: [const { LinkShared::new() }; _],
            configured: Signal::new(),
            temperature: Signal::new(),
            requests: Channel::new(),
            active: Mutex::new(RefCell::new(SetBytes::NONE)),
            key_lost: Signal::new(),
            published: Mutex::new(RefCell::new(Slot::Empty)),
        }
    }

    fn link(&self, role: LinkRole) -> &LinkShared<M> {
        match (&self.links, role) {
            ([cable, ..], LinkRole::Cable) => cable,
            ([.., last], _) => last,
        }
    }

    /// Notes that a task has gone around its loop.
    pub(crate) fn progressed(&self, worker: Worker) {
        let [sampler, control, cable, wireless] = &self.progress;
        let turns = match worker {
            Worker::Sampler => sampler,
            Worker::Control => control,
            Worker::Writer(LinkRole::Cable) => cable,
            Worker::Writer(_) => wireless,
        };
        // Only the task itself writes it; a Cortex-M0+ has no atomic addition.
        let next = turns.load(Ordering::Relaxed).wrapping_add(1);
        turns.store(next, Ordering::Relaxed);
    }

    pub(crate) fn lock(&self) -> Lock {
        self.with_published(|published| published.lock)
    }

    pub(crate) fn published(&self) -> Published {
        self.with_published(|published| *published)
    }

    /// Whether stored parameters and settings are not to be used.
    pub(crate) fn is_safe_mode(&self) -> bool {
        self.with_published(|published| published.hello.safe_mode)
    }

    /// The id of the parameters in use.
    pub(crate) fn parameters(&self) -> ParameterId {
        self.with_published(|published| published.parameters)
    }

    pub(crate) fn settings(&self) -> Settings {
        self.with_published(|published| published.settings)
    }

    pub(crate) fn publish(&self, change: impl FnOnce(&mut Published)) {
        self.with_published(change);
    }

    pub(crate) fn with_published<R>(&self, f: impl FnOnce(&mut Published) -> R) -> R {
        self.published.lock(|published| f(published.borrow_mut().or_new(Published::new)))
    }

    /// The set in use.
    pub(crate) fn active(&self) -> SetBytes {
        self.active.lock(|active| *active.borrow())
    }

    /// Uses a set, with the id of its source, from now on.
    pub(crate) fn activate(&self, set: &SetBytes, id: ParameterId) {
        self.active.lock(|active| *active.borrow_mut() = *set);
        self.publish(|published| published.parameters = id);
    }

    /// The responder of a link.
    pub(crate) async fn responder(&self, role: LinkRole) -> MappedMutexGuard<'_, M, Responder> {
        let new = match role {
            LinkRole::Cable => || Responder::new(LinkRole::Cable),
            _ => || Responder::new(LinkRole::Wireless),
        };
        let responder = self.link(role).responder.lock().await;
        MutexGuard::map(responder, |responder| responder.or_new(new))
    }

    pub(crate) fn with_heard<R>(&self, role: LinkRole, f: impl FnOnce(&mut Heard) -> R) -> R {
        self.link(role).heard.lock(|cell| {
            let mut heard = cell.get();
            let result = f(&mut heard);
            cell.set(heard);
            result
        })
    }

    /// Notes that a fault has begun, or ended, for later listeners.
    pub(crate) fn set_fault(
        &self,
        fault: PersistentFault,
        now: DeviceTimeUs,
        event: Option<Event>,
    ) {
        self.publish(|published| {
            if let Some(known) = published.faults.get_mut(fault as usize) {
                *known = event.map(|event| (now, event));
            }
        });
    }

    /// Whether a link needs an epoch; clears the flag.
    pub(crate) fn take_epoch_wanted(&self, role: LinkRole) -> bool {
        self.with_heard(role, |heard| core::mem::take(&mut heard.epoch_wanted))
    }

    fn want_epoch(&self, role: LinkRole) {
        self.with_heard(role, |heard| heard.epoch_wanted = true);
    }

    fn health(&self) -> Health {
        self.with_published(|published| {
            let shed = ROLES.map(|role| {
                let outbox = &self.link(role).outbox;
                outbox.lock(|outbox| outbox.borrow().shed)
            });
            Health {
                samples: published.sensor.samples,
                sensor_lost: matches!(
                    published.faults.get(PersistentFault::Sensor as usize),
                    Some(Some(_))
                ),
                calibrated: published.parameters != ParameterId::UNCALIBRATED,
                shed: shed.into_iter().fold(0, u32::wrapping_add),
            }
        })
    }
}
