//! What the node's tasks share.

use core::cell::{Cell, RefCell};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::mutex::{MappedMutexGuard, Mutex as AsyncMutex, MutexGuard};
use embassy_sync::signal::Signal;
use wimu_integrator::Compass;
use wimu_link::auth::Lock;
use wimu_link::frame::MAX_FRAME;
use wimu_link::message::{
    ActiveParameters, Command, EncodedParameters, Event, LinkStatus, SensorStatus, Settings,
    Status, Streams, Telemetry, WireParameters,
};
use wimu_link::{Hello, LinkRole, Responder};
use wimu_model::{CentiCelsius, Corrector, DeviceTimeUs, ParameterId};

use crate::accelerometer::{Plan, SensorFault};
use crate::queue::{FrameQueue, PIECE};
use crate::slot::Slot;

/// The longest message that may be shed: a status, with what is around it.
const MAX_SHED: usize = 192;

/// What a device sends: parameters as they travel.
pub(crate) type Message<'a> = Telemetry<EncodedParameters<'a>>;

/// Both links.
pub(crate) const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// Memory that a node's tasks share: put it in a `static`, or where it outlives them.
///
/// `M` is the mutex of the priorities at which the tasks run: `CriticalSectionRawMutex` where
/// sampling interrupts the rest, `NoopRawMutex` where one executor polls all.
pub struct Shared<M: RawMutex> {
    links: [LinkShared<M>; 2],
    pub(crate) orders: Orders<M>,
    pub(crate) configured: Signal<M, Result<(), SensorFault>>,
    pub(crate) temperature: Signal<M, CentiCelsius>,
    /// What hosts ask for. The parameters that are to be staged lie on the desk.
    pub(crate) requests: Channel<M, (LinkRole, Command<()>), 1>,
    pub(crate) desk: Desk<M>,
    /// The parameter set in use; of no length without one.
    active: Mutex<M, RefCell<Set>>,
    pub(crate) key_lost: Signal<M, ()>,
    /// Rates to store.
    pub(crate) rates: Channel<M, (LinkRole, u32), 2>,
    /// Mean specific force of a rest that has begun, 2⁻³² m/s², body axes, and the parameters it
    /// was corrected with.
    pub(crate) rest: Signal<M, ([i64; 3], ParameterId)>,
    /// From the first that is said.
    published: Mutex<M, RefCell<Slot<Published>>>,
}

struct LinkShared<M: RawMutex> {
    outbox: Mutex<M, RefCell<FrameQueue>>,
    waiting: Signal<M, ()>,
    /// From the first request on. It checks signatures and makes them: it is never held with
    /// interrupts off, which would make the times of samples late.
    responder: AsyncMutex<M, Slot<Responder>>,
    heard: Mutex<M, Cell<Heard>>,
    rate: RateSignals<M>,
    /// The nearest rate that the line can run at, if it can be set.
    nearest_rate: Mutex<M, Cell<Option<NearestRate>>>,
}

impl<M: RawMutex> LinkShared<M> {
    const fn new() -> Self {
        Self {
            outbox: Mutex::new(RefCell::new(FrameQueue::new())),
            waiting: Signal::new(),
            responder: AsyncMutex::new(Slot::Empty),
            heard: Mutex::new(Cell::new(Heard::NOTHING)),
            rate: RateSignals {
                order: Signal::new(),
                heard: Signal::new(),
                noise: Signal::new(),
            },
            nearest_rate: Mutex::new(Cell::new(None)),
        }
    }
}

/// The rate nearest to one, bits/s, that a line can run at.
type NearestRate = fn(u32) -> u32;

/// What whoever keeps a line's rate is told.
pub(crate) struct RateSignals<M: RawMutex> {
    pub(crate) order: Signal<M, RateOrder>,
    /// An undamaged frame of a host has come.
    pub(crate) heard: Signal<M, ()>,
    /// Bytes have come that ended no undamaged frame.
    pub(crate) noise: Signal<M, ()>,
}

/// What is to become of a line's rate, bits/s.
#[derive(Clone, Copy)]
pub(crate) enum RateOrder {
    /// This is stored.
    Use(Option<u32>),
    /// Change to this, and back if no host is heard.
    Try(u32),
}

/// What has been heard on a link.
#[derive(Clone, Copy)]
pub(crate) struct Heard {
    pub(crate) damaged: u32,
    /// Requests that were there already.
    pub(crate) repeated: u32,
    /// Somebody has begun to listen, or has missed something.
    epoch_wanted: bool,
    /// The parameters in use are to be told, and there was no room for them.
    parameters_wanted: bool,
}

impl Heard {
    const NOTHING: Self = Self {
        damaged: 0,
        repeated: 0,
        epoch_wanted: false,
        parameters_wanted: false,
    };
}

/// The parameter set that a host has sent, and then the one that is staged. Who has written it must
/// find it as it was: it may be held over a wait.
pub(crate) type Desk<M> = AsyncMutex<M, Staged>;

/// A set on the desk.
pub(crate) struct Staged {
    pub(crate) set: Set,
    /// The link that it came on, and that has not been told what becomes of it.
    pub(crate) from: Slot<LinkRole>,
    /// Its id, once it has been found good.
    pub(crate) id: Option<ParameterId>,
}

/// A parameter set as it travels.
#[derive(Clone, Copy)]
pub(crate) struct Set {
    bytes: [u8; WireParameters::MAX],
    length: u16,
}

impl Set {
    const NONE: Self = Self {
        bytes: [0; _],
        length: 0,
    };

    /// The set; `None` if there is none.
    pub(crate) fn get(&self) -> Option<EncodedParameters<'_>> {
        let bytes = self.bytes.get(..self.length.into())?;
        (!bytes.is_empty()).then_some(EncodedParameters(bytes))
    }

    /// Takes the wire form of `set`; returns its id.
    pub(crate) fn encode(&mut self, set: &WireParameters) -> ParameterId {
        let length = set.encode(&mut self.bytes);
        self.length = length.unwrap_or(0) as u16;
        self.get()
            .map_or(ParameterId::UNCALIBRATED, EncodedParameters::id)
    }

    pub(crate) fn put(&mut self, set: Option<EncodedParameters>) {
        let bytes = set.map_or(&[][..], |set| set.0);
        self.length = 0;
        if let Some(place) = self.bytes.get_mut(..bytes.len()) {
            place.copy_from_slice(bytes);
            self.length = bytes.len() as u16;
        }
    }
}

/// What the sampler is told.
#[allow(clippy::large_enum_variant)] // One of them exists.
pub(crate) enum Order {
    /// Run the sensor in this way, and say how that went.
    Configure(Plan, Correction),
    /// Correct with this from the next sample on; navigation starts anew if the parameters changed.
    Correct(Correction),
}

/// One order at a time. It stays where it is until it has been obeyed: nobody else needs room for
/// it while the sensor is configured.
pub(crate) struct Orders<M: RawMutex> {
    order: Mutex<M, RefCell<Slot<Order>>>,
    pub(crate) given: Signal<M, ()>,
    taken: Signal<M, ()>,
}

impl<M: RawMutex> Orders<M> {
    const fn new() -> Self {
        Self {
            order: Mutex::new(RefCell::new(Slot::Empty)),
            given: Signal::new(),
            taken: Signal::new(),
        }
    }

    /// Waits until the order before has been obeyed.
    pub(crate) async fn room(&self) {
        while self.order.lock(|order| order.borrow().as_ref().is_some()) {
            self.taken.wait().await;
        }
    }

    pub(crate) fn give(&self, new: Order) {
        self.order
            .lock(|order| *order.borrow_mut() = Slot::Full(new));
        self.given.signal(());
    }

    /// How the sensor is to run, if that is what is ordered.
    pub(crate) fn plan(&self) -> Option<Plan> {
        self.order.lock(|order| match order.borrow().as_ref() {
            Some(Order::Configure(plan, _)) => Some(*plan),
            _ => None,
        })
    }

    pub(crate) fn take(&self) -> Option<Order> {
        let order = self.order.lock(|order| order.borrow_mut().take());
        self.taken.signal(());
        order
    }
}

/// What can be wrong with a device for longer.
#[derive(Clone, Copy)]
pub(crate) enum Trouble {
    Sensor,
    BootCount,
    Settings,
    Parameters,
    DeviceKey,
    #[cfg(feature = "self-check")]
    Calibration,
}

impl Trouble {
    const COUNT: usize = 6;
}

/// How a device is, in short.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Health {
    /// Samples read since the start, modulo 2³²: they grow while the sensor works.
    pub samples: u32,
    /// The sensor has failed and is tried again.
    pub sensor_lost: bool,
    /// Parameters are in use.
    pub calibrated: bool,
    /// Frames that slow links made the device drop, modulo 2³²: they grow while a link is poor.
    pub shed: u32,
}

/// A corrector and what it was compiled from.
#[derive(Clone, Copy)]
pub(crate) struct Correction {
    pub(crate) corrector: Corrector,
    pub(crate) parameters: ParameterId,
    pub(crate) temperature: Option<CentiCelsius>,
    /// Of a set with a calibrated magnetometer.
    pub(crate) compass: Option<Compass>,
}

/// What is true of the device now, for whoever asks.
#[derive(Clone, Copy)]
pub(crate) struct Published {
    pub(crate) hello: Hello,
    /// Who may write.
    pub(crate) lock: Lock,
    pub(crate) settings: Settings,
    /// Those in use.
    pub(crate) parameters: ParameterId,
    pub(crate) sensor: SensorStatus,
    pub(crate) measured_period_ns: Option<u32>,
    pub(crate) jitter_ns: Option<u32>,
    /// What is wrong, by [`Trouble`], and since when.
    troubles: [Option<(DeviceTimeUs, Event)>; Trouble::COUNT],
    /// Whether the store has been read; before that there is nothing to say.
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
            troubles: [None; Trouble::COUNT],
            ready: false,
        }
    }
}

impl<M: RawMutex> Shared<M> {
    /// Memory for one node: zeros all of it, which a `static` of it takes no flash for.
    pub const fn new() -> Self {
        Self {
            links: [const { LinkShared::new() }; 2],
            orders: Orders::new(),
            configured: Signal::new(),
            temperature: Signal::new(),
            requests: Channel::new(),
            desk: Desk::new(Staged {
                set: Set::NONE,
                from: Slot::Empty,
                id: None,
            }),
            active: Mutex::new(RefCell::new(Set::NONE)),
            key_lost: Signal::new(),
            rates: Channel::new(),
            rest: Signal::new(),
            published: Mutex::new(RefCell::new(Slot::Empty)),
        }
    }

    fn link(&self, role: LinkRole) -> &LinkShared<M> {
        let [cable, wireless] = &self.links;
        match role {
            LinkRole::Cable => cable,
            _ => wireless,
        }
    }

    /// Has the device forget its key and its settings, never its calibration. A board calls it
    /// when its owner, who has lost the key, makes a gesture that takes hands on the board: a
    /// button held down for seconds, or a pin connected to ground when power comes.
    pub fn forget_key(&self) {
        self.key_lost.signal(());
    }

    pub(crate) fn has_rate(&self, role: LinkRole, nearest: NearestRate) {
        self.link(role)
            .nearest_rate
            .lock(|known| known.set(Some(nearest)));
    }

    /// The rate nearest to `baud` that a link's line can run at; `None` if it cannot be set.
    pub(crate) fn nearest_rate(&self, role: LinkRole, baud: u32) -> Option<u32> {
        let nearest = self.link(role).nearest_rate.lock(Cell::get)?;
        Some(nearest(baud))
    }

    pub(crate) fn rate_signals(&self, role: LinkRole) -> &RateSignals<M> {
        &self.link(role).rate
    }

    pub(crate) fn lock(&self) -> Lock {
        self.with_published(|published| published.lock)
    }

    pub(crate) fn published(&self) -> Published {
        self.with_published(|published| *published)
    }

    /// Those in use.
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
        self.published
            .lock(|published| f(published.borrow_mut().or_new(Published::new)))
    }

    /// The set in use, of which only its user has a copy; of no length without one.
    pub(crate) fn active(&self) -> Set {
        self.active.lock(|active| *active.borrow())
    }

    /// Takes a set into use, or none.
    pub(crate) fn activate(&self, set: Option<EncodedParameters>) {
        self.active.lock(|active| active.borrow_mut().put(set));
        let id = set.map_or(ParameterId::UNCALIBRATED, EncodedParameters::id);
        self.publish(|published| published.parameters = id);
    }

    /// Who answers the requests of a link.
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

    fn with_outbox<R>(&self, role: LinkRole, f: impl FnOnce(&mut FrameQueue) -> R) -> R {
        let link = self.link(role);
        let result = link.outbox.lock(|outbox| f(&mut outbox.borrow_mut()));
        link.waiting.signal(());
        result
    }

    /// Queues an encoded frame that is never shed.
    pub(crate) fn keep(&self, role: LinkRole, frame: &[u8]) {
        self.with_outbox(role, |outbox| outbox.push_kept(frame));
    }

    /// Queues an encoded frame that is never shed, if that leaves room for a signed reply.
    pub(crate) fn keep_if_room(&self, role: LinkRole, frame: &[u8]) {
        self.with_outbox(role, |outbox| outbox.push_unsigned(frame));
    }

    /// Queues a message that is shed when the link is too slow, on the links that want it.
    pub(crate) fn stream(&self, roles: [bool; 2], message: &Message, wanted: fn(&Streams) -> bool) {
        let mut frame = [0; MAX_SHED];
        let length = message.encode(&mut frame).unwrap_or(0);
        self.stream_frame(roles, frame.get(..length).unwrap_or_default(), wanted);
    }

    /// The same of an encoded frame.
    pub(crate) fn stream_frame(
        &self,
        roles: [bool; 2],
        frame: &[u8],
        wanted: fn(&Streams) -> bool,
    ) {
        let settings = self.settings();
        for ((role, on), streams) in ROLES
            .into_iter()
            .zip(roles)
            .zip([settings.cable, settings.wireless])
        {
            if on && wanted(&streams) {
                self.with_outbox(role, |outbox| outbox.push_telemetry(frame));
            }
        }
    }

    /// Queues a message on the links named, the cable first; never shed.
    pub(crate) fn announce(&self, message: &Message, roles: [bool; 2]) {
        let mut frame = [0; MAX_FRAME];
        if let Ok(length) = message.encode(&mut frame) {
            for (role, _) in ROLES.into_iter().zip(roles).filter(|(_, on)| *on) {
                self.keep(role, frame.get(..length).unwrap_or_default());
            }
        }
    }

    /// Queues a message on one link; never shed.
    fn tell(&self, role: LinkRole, message: &Message) {
        self.announce(message, ROLES.map(|other| other == role));
    }

    /// Queues the parameters in use on one link, or has them queued when there is room.
    pub(crate) fn tell_parameters(&self, role: LinkRole) {
        let active = self.active();
        let message: Message = Telemetry::Parameters(active_parameters(&active));
        let mut frame = [0; MAX_FRAME];
        let length = message.encode(&mut frame).unwrap_or(0);
        let frame = frame.get(..length).unwrap_or_default();
        let queued = self.with_outbox(role, |outbox| outbox.push_kept_if_room(frame));
        self.with_heard(role, |heard| heard.parameters_wanted = !queued);
    }

    /// Tells both links what has happened.
    pub(crate) fn report(&self, now: DeviceTimeUs, event: Event) {
        let time_us = now.0;
        self.announce(&Telemetry::Event { time_us, event }, [true; 2]);
    }

    /// Notes what is wrong, or no longer, for those who begin to listen later.
    pub(crate) fn trouble(&self, trouble: Trouble, now: DeviceTimeUs, event: Option<Event>) {
        self.publish(|published| {
            if let Some(known) = published.troubles.get_mut(trouble as usize) {
                *known = event.map(|event| (now, event));
            }
        });
    }

    /// Whether a link wants an epoch; it wants it no more then.
    pub(crate) fn take_epoch_wanted(&self, role: LinkRole) -> bool {
        self.with_heard(role, |heard| core::mem::take(&mut heard.epoch_wanted))
    }

    fn want_epoch(&self, role: LinkRole) {
        self.with_heard(role, |heard| heard.epoch_wanted = true);
    }

    /// Who the device is, its settings, its parameters, how it is and what is wrong with it: what
    /// a listener needs before anything else. The epoch that completes it is asked of the sampler.
    pub(crate) fn introduce(&self, role: LinkRole, now: DeviceTimeUs) {
        let published = self.published();
        if !published.ready {
            return;
        }
        let hello = Hello {
            role,
            access: published.lock.access(role),
            uptime_us: now.0,
            parameter_id: published.parameters,
            ..published.hello
        };
        let mut frame = [0; MAX_FRAME];
        if let Ok(length) = hello.encode(&mut frame) {
            self.keep(role, frame.get(..length).unwrap_or_default());
        }
        self.tell(role, &Telemetry::Settings(published.settings));
        self.tell_parameters(role);
        self.tell(role, &Telemetry::Status(self.status(now)));
        for &(since, event) in published.troubles.iter().flatten() {
            let time_us = since.0;
            self.tell(role, &Telemetry::Event { time_us, event });
        }
        self.want_epoch(role);
    }

    pub(crate) fn status(&self, now: DeviceTimeUs) -> Status {
        let published = self.published();
        let link = |role| {
            let (damaged, repeated) =
                self.with_heard(role, |heard| (heard.damaged, heard.repeated));
            self.link(role).outbox.lock(|outbox| {
                let outbox = outbox.borrow();
                LinkStatus {
                    frames_sent: outbox.frames_sent,
                    bytes_sent: outbox.bytes_sent,
                    telemetry_shed: outbox.shed,
                    frames_damaged: damaged,
                    requests_repeated: repeated,
                }
            })
        };
        Status {
            uptime_us: now.0,
            cable: Some(link(LinkRole::Cable)),
            wireless: Some(link(LinkRole::Wireless)),
            sensor: published.sensor,
            measured_period_ns: published.measured_period_ns,
            jitter_ns: published.jitter_ns,
        }
    }

    /// How the device is, in short: for its lamps.
    pub fn health(&self) -> Health {
        self.with_published(|published| {
            let shed = ROLES.map(|role| {
                let outbox = &self.link(role).outbox;
                outbox.lock(|outbox| outbox.borrow().shed)
            });
            let [cable, wireless] = shed;
            Health {
                samples: published.sensor.samples,
                sensor_lost: matches!(
                    published.troubles.get(Trouble::Sensor as usize),
                    Some(Some(_))
                ),
                calibrated: published.parameters != ParameterId::UNCALIBRATED,
                shed: cable.wrapping_add(wireless),
            }
        })
    }

    /// Tells both links that the button at the device was pressed, for the time `count`.
    pub fn mark(&self, now: DeviceTimeUs, count: u16) {
        self.report(now, Event::Marked { count });
    }

    /// Whether all that must not be shed has left a link.
    pub(crate) fn is_drained(&self, role: LinkRole) -> bool {
        self.link(role)
            .outbox
            .lock(|outbox| outbox.borrow().is_drained())
    }

    /// The frame whose last piece was taken is over the line.
    pub(crate) fn frame_sent(&self, role: LinkRole) {
        self.link(role)
            .outbox
            .lock(|outbox| outbox.borrow_mut().sending = false);
    }

    /// Waits for the next piece of a frame to send on a link and takes it.
    pub(crate) async fn next_piece(
        &self,
        role: LinkRole,
        piece: &mut [u8; PIECE],
    ) -> (usize, bool) {
        let link = self.link(role);
        loop {
            let room = link.outbox.lock(|outbox| outbox.borrow().has_all_room());
            if room && self.with_heard(role, |heard| heard.parameters_wanted) {
                self.tell_parameters(role);
            }
            let (taken, stalled) = link.outbox.lock(|outbox| {
                let mut outbox = outbox.borrow_mut();
                let taken = outbox.pop(piece);
                (
                    taken,
                    taken.0 == 0 && core::mem::take(&mut outbox.overflowed),
                )
            });
            if taken.0 > 0 {
                return taken;
            }
            if stalled {
                // What the listener missed may have been an epoch.
                self.want_epoch(role);
            }
            link.waiting.wait().await;
        }
    }
}

impl<M: RawMutex> Default for Shared<M> {
    fn default() -> Self {
        Self::new()
    }
}

/// What the hosts are told of the parameters in use.
pub(crate) fn active_parameters(set: &Set) -> ActiveParameters<EncodedParameters<'_>> {
    let active = set.get();
    ActiveParameters {
        active,
        id: active
            .map_or(ParameterId::UNCALIBRATED, EncodedParameters::id)
            .0,
    }
}
