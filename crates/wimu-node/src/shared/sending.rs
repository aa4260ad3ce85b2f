//! Messages to the hosts: encoded, and queued for the links.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::frame::MAX_FRAME;
use wimu_link::message::{Event, LinkStatus, Status, Streams, Telemetry};
use wimu_link::{Hello, LinkRole};
use wimu_model::DeviceTimeUs;

use super::{ALL, Common, Message, ROLES, Roles, runs};
use crate::queue::{FrameQueue, PIECE};

/// Longest telemetry message (a status) in its frame, bytes.
const MAX_TELEMETRY: usize = 192;

impl<M: RawMutex> Common<M> {
    fn with_outbox<R>(&self, role: LinkRole, f: impl FnOnce(&mut FrameQueue) -> R) -> R {
        let link = self.link(role);
        let result = link.outbox.lock(|outbox| f(&mut outbox.borrow_mut()));
        link.waiting.signal(());
        result
    }

    /// Queues an encoded frame that is kept: dropped only when the link has stalled.
    pub(crate) fn keep(&self, role: LinkRole, frame: &[u8]) {
        self.with_outbox(role, |outbox| outbox.push_kept(frame));
    }

    /// Queues an encoded frame that is kept, if room for a signed reply remains.
    pub(crate) fn keep_if_room(&self, role: LinkRole, frame: &[u8]) {
        self.with_outbox(role, |outbox| outbox.push_unsigned(frame));
    }

    /// Queues a message that is dropped when the link is too slow, on the links that want it.
    pub(crate) fn stream(&self, roles: Roles, message: &Message, wanted: fn(&Streams) -> bool) {
        let mut frame = [0; MAX_TELEMETRY];
        let length = message.encode(&mut frame).unwrap_or(0);
        self.stream_frame(roles, frame.get(..length).unwrap_or_default(), wanted);
    }

    /// Queues an encoded frame that is dropped when the link is too slow, on the links that want it.
    pub(crate) fn stream_frame(&self, roles: Roles, frame: &[u8], wanted: fn(&Streams) -> bool) {
        let settings = self.settings();
        for ((role, on), streams) in
            ROLES.into_iter().zip(roles).zip([settings.cable, settings.wireless])
        {
            if on && wanted(&streams) {
                self.with_outbox(role, |outbox| outbox.push_telemetry(frame));
            }
        }
    }

    /// Queues a message that is kept on the chosen links, in the order of [`ROLES`]: dropped only when a link
    /// has stalled.
    pub(crate) fn announce(&self, message: &Message, roles: Roles) {
        let mut frame = [0; MAX_FRAME];
        if let Ok(length) = message.encode(&mut frame) {
            for (role, _) in ROLES.into_iter().zip(roles).filter(|(_, on)| *on) {
                self.keep(role, frame.get(..length).unwrap_or_default());
            }
        }
    }

    /// Queues a message that is kept on one link.
    fn send(&self, role: LinkRole, message: &Message) {
        self.announce(message, ROLES.map(|other| other == role));
    }

    /// Sends the parameters in use on one link, when no kept frame is queued.
    pub(crate) fn send_parameters(&self, role: LinkRole) {
        self.with_heard(role, |heard| heard.parameters_wanted = true);
        self.link(role).waiting.signal(());
    }

    /// Sends an event on both links.
    pub(crate) fn report(&self, now: DeviceTimeUs, event: Event) {
        let time_us = now.0;
        self.announce(&Telemetry::Event { time_us, event }, ALL);
    }

    /// Sends what a new listener needs: Hello, settings, parameters, status and present faults. The sampler
    /// adds an epoch.
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
        self.send(role, &Telemetry::Settings(published.settings));
        self.send_parameters(role);
        self.send(role, &Telemetry::Status(self.status(now)));
        for &(since, event) in published.faults.iter().flatten() {
            let time_us = since.0;
            self.send(role, &Telemetry::Event { time_us, event });
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
            wireless: runs(LinkRole::Wireless).then(|| link(LinkRole::Wireless)),
            sensor: published.sensor,
            measured_period_ns: published.measured_period_ns,
            jitter_ns: published.jitter_ns,
            stack: published.stack,
        }
    }

    /// Whether every kept frame has been sent on a link.
    pub(crate) fn is_drained(&self, role: LinkRole) -> bool {
        self.link(role).outbox.lock(|outbox| outbox.borrow().is_drained())
    }

    /// Notes that the frame whose last piece was taken has been transmitted.
    pub(crate) fn frame_sent(&self, role: LinkRole) {
        self.link(role).outbox.lock(|outbox| outbox.borrow_mut().sending = false);
    }

    /// Counts a frame that was sent beside the queue.
    #[cfg(feature = "auth")]
    pub(crate) fn count_sent(&self, role: LinkRole, bytes: usize) {
        self.link(role).outbox.lock(|outbox| {
            let mut outbox = outbox.borrow_mut();
            outbox.frames_sent = outbox.frames_sent.wrapping_add(1);
            outbox.bytes_sent = outbox.bytes_sent.wrapping_add(bytes as u64);
        });
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
            if room && self.with_heard(role, |heard| core::mem::take(&mut heard.parameters_wanted))
            {
                self.send(role, &Telemetry::Parameters(self.active()));
            }
            let (taken, stalled) = link.outbox.lock(|outbox| {
                let mut outbox = outbox.borrow_mut();
                let taken = outbox.pop(piece);
                (taken, taken.0 == 0 && core::mem::take(&mut outbox.overflowed))
            });
            if taken.0 > 0 {
                return taken;
            }
            if stalled {
                // The dropped frames may have included an epoch.
                self.want_epoch(role);
            }
            link.waiting.wait().await;
        }
    }
}
