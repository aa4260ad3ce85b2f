//! Queue of frames for a link.

/// Room for telemetry, of which the oldest frames are dropped when the link is too slow, bytes.
const TELEMETRY_BYTES: usize = 1024;
/// Room for kept frames, bytes: everything that is sent to a new listener at its longest, except the parameters, which are
/// queued when there is room; and a signed reply. Without navigation an epoch has no state.
const KEPT_BYTES: usize = kept(if cfg!(feature = "navigation") { EPOCH } else { EPOCH_HEAD })
    + kept(HELLO)
    + kept(SETTINGS)
    + kept(STATUS)
    + 5 * kept(EVENT)
    + SIGNED_BYTES;
/// The longest bodies, bytes.
const EPOCH: usize = wimu_link::MAX_BODY;
const EPOCH_HEAD: usize = 160;
const HELLO: usize = 110;
const SETTINGS: usize = 24;
const STATUS: usize = 117;
const EVENT: usize = 14;

/// Bytes that a frame with this body takes in the queue: length, kind, CRC, COBS, zero.
const fn kept(body: usize) -> usize {
    2 + 1 + body + 4 + 4 + 1
}

/// Room that unsigned replies leave free, bytes: the longest signed reply to a write, and its length.
const SIGNED_BYTES: usize = 80 + 2;
/// Bytes of a frame that are taken at once.
pub(crate) const PIECE: usize = 64;

/// The frames queued for one link: telemetry, of which the oldest is dropped when there is no room, and kept
/// frames, which are sent first and dropped only when the link has stalled.
pub(crate) struct FrameQueue {
    kept: Ring<[u8; KEPT_BYTES]>,
    telemetry: Ring<[u8; TELEMETRY_BYTES]>,
    /// Frames dropped because the link was too slow; after a stall, kept frames too.
    pub(crate) shed: u32,
    pub(crate) frames_sent: u32,
    pub(crate) bytes_sent: u64,
    /// A kept frame found no room since the link was last drained: the link has stalled.
    pub(crate) overflowed: bool,
    /// A piece has been taken and is being transmitted.
    pub(crate) sending: bool,
}

impl FrameQueue {
    pub(crate) const fn new() -> Self {
        Self {
            kept: Ring::new([0; _]),
            telemetry: Ring::new([0; _]),
            shed: 0,
            frames_sent: 0,
            bytes_sent: 0,
            overflowed: false,
            sending: false,
        }
    }

    /// Queues a telemetry frame; drops the oldest ones if there is no room.
    pub(crate) fn push_telemetry(&mut self, frame: &[u8]) {
        let telemetry: &mut Ring<[u8]> = &mut self.telemetry;
        while !telemetry.push(frame) {
            if !telemetry.drop_oldest() {
                return;
            }
            self.shed = self.shed.saturating_add(1);
        }
    }

    /// Queues a kept frame. If there is no room, the link has stalled: all queued frames
    /// are dropped and counted.
    pub(crate) fn push_kept(&mut self, frame: &[u8]) {
        let kept: &mut Ring<[u8]> = &mut self.kept;
        if kept.push(frame) {
            return;
        }
        self.overflowed = true;
        let telemetry: &mut Ring<[u8]> = &mut self.telemetry;
        while kept.drop_oldest() || telemetry.drop_oldest() {
            self.shed = self.shed.saturating_add(1);
        }
        kept.push(frame);
    }

    /// Queues a kept frame if there is room without dropping others; returns whether there was.
    pub(crate) fn push_kept_if_room(&mut self, frame: &[u8]) -> bool {
        let kept: &mut Ring<[u8]> = &mut self.kept;
        kept.push(frame)
    }

    /// Queues a reply to an unsigned request, if room for a signed one remains.
    pub(crate) fn push_unsigned(&mut self, frame: &[u8]) {
        if self.kept.used + 2 + frame.len() + SIGNED_BYTES <= KEPT_BYTES {
            self.push_kept_if_room(frame);
        }
    }

    /// Whether no kept frame, or part of one, is queued.
    pub(crate) fn has_all_room(&self) -> bool {
        self.kept.used == 0
    }

    /// Whether no kept frame is queued and nothing is being sent.
    pub(crate) fn is_drained(&self) -> bool {
        self.has_all_room() && !self.sending
    }

    /// Takes the next piece to send; returns its length, 0 if nothing is queued, and whether it ends a
    /// frame.
    pub(crate) fn pop(&mut self, piece: &mut [u8; PIECE]) -> (usize, bool) {
        let kept: &mut Ring<[u8]> = &mut self.kept;
        let telemetry: &mut Ring<[u8]> = &mut self.telemetry;
        let begun = telemetry.begun > 0;
        let length = match if begun { 0 } else { kept.pop(piece) } {
            0 => telemetry.pop(piece),
            length => length,
        };
        let ended = kept.begun == 0 && telemetry.begun == 0;
        if length > 0 {
            self.sending = true;
            self.frames_sent = self.frames_sent.wrapping_add(ended.into());
            self.bytes_sent = self.bytes_sent.wrapping_add(length as u64);
        }
        (length, ended)
    }
}

/// Frames in a ring of bytes, each after its length. The methods are those of `Ring<[u8]>`, so that their code
/// exists once for all sizes.
///
/// `heapless::Deque` would append and remove single bytes, several times as slow as these block copies, which
/// are made with interrupts disabled.
struct Ring<B: ?Sized> {
    start: usize,
    used: usize,
    /// Bytes left of a frame that has been taken in part. They are at the start, without a length.
    begun: usize,
    bytes: B,
}

impl<B> Ring<B> {
    const fn new(bytes: B) -> Self {
        Self { start: 0, used: 0, begun: 0, bytes }
    }
}

impl Ring<[u8]> {
    /// Appends a frame if there is room.
    fn push(&mut self, frame: &[u8]) -> bool {
        let Ok(length) = u16::try_from(frame.len()) else {
            return false;
        };
        if frame.is_empty() || self.used + 2 + frame.len() > self.bytes.len() {
            return false;
        }
        self.append(&length.to_le_bytes());
        self.append(frame);
        true
    }

    /// Removes the next bytes of the oldest frame into `piece`; 0 if the queue is empty.
    fn pop(&mut self, piece: &mut [u8; PIECE]) -> usize {
        if self.begun == 0 && self.used > 0 {
            self.begun = self.length_at(0);
            self.skip(2);
        }
        let mut taken = 0;
        for (place, byte) in piece.iter_mut().zip(0..self.begun) {
            *place = self.at(byte);
            taken += 1;
        }
        self.begun -= taken;
        self.skip(taken);
        taken
    }

    /// Removes the oldest frame of which nothing has been taken.
    fn drop_oldest(&mut self) -> bool {
        if self.used == self.begun {
            return false;
        }
        let removed = 2 + self.length_at(self.begun);
        // Moves the rest of the begun frame up.
        for byte in (0..self.begun).rev() {
            let (value, to) = (self.at(byte), self.place(byte + removed));
            if let Some(place) = self.bytes.get_mut(to) {
                *place = value;
            }
        }
        self.skip(removed);
        true
    }

    /// The length stored at `offset` bytes after the start.
    fn length_at(&self, offset: usize) -> usize {
        usize::from(u16::from_le_bytes([self.at(offset), self.at(offset + 1)]))
    }

    /// The byte at `offset` bytes after the start.
    fn at(&self, offset: usize) -> u8 {
        self.bytes.get(self.place(offset)).copied().unwrap_or(0)
    }

    /// The index of the byte at `offset` bytes after the start. Without a division, which some processors do
    /// not have.
    fn place(&self, offset: usize) -> usize {
        let place = self.start + offset;
        place.checked_sub(self.bytes.len()).unwrap_or(place)
    }

    fn append(&mut self, bytes: &[u8]) {
        let end = self.place(self.used);
        let (start, rest) = self.bytes.split_at_mut(end.min(self.bytes.len()));
        let (before_wrap, after_wrap) = bytes.split_at(bytes.len().min(rest.len()));
        for (part, place) in [(before_wrap, rest), (after_wrap, start)] {
            if let Some(place) = place.get_mut(..part.len()) {
                place.copy_from_slice(part);
            }
        }
        self.used += bytes.len();
    }

    fn skip(&mut self, bytes: usize) {
        self.start = self.place(bytes);
        self.used -= bytes;
    }
}

#[cfg(all(test, feature = "full"))]
mod tests {
    use wimu_link::MAX_FRAME;
    use wimu_link::message::{
        Epoch, EpochGyroscope, Event, LinkStatus, SensorStatus, Settings, StackStatus, Status,
        Telemetry,
    };

    use super::*;

    fn frame(queue: &mut FrameQueue) -> std::vec::Vec<u8> {
        let before = queue.frames_sent;
        let mut frame = std::vec::Vec::new();
        let mut piece = [0; PIECE];
        while queue.frames_sent == before {
            match queue.pop(&mut piece) {
                (0, _) => break,
                (length, _) => frame.extend(&piece[..length]),
            }
        }
        frame
    }

    fn pop(queue: &mut FrameQueue) -> Option<u8> {
        frame(queue).first().copied()
    }

    #[test]
    fn the_oldest_telemetry_is_shed_first_and_counted() {
        let mut queue = FrameQueue::new();
        for id in 0..30 {
            queue.push_telemetry(&[id; 100]);
        }
        let kept: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
        assert_eq!(kept.last(), Some(&29));
        assert_eq!(usize::from(kept[0]), 30 - kept.len());
        assert_eq!(queue.shed, u32::from(kept[0]));
    }

    #[test]
    fn kept_frames_go_first_and_survive_a_flood_of_telemetry() {
        let mut queue = FrameQueue::new();
        queue.push_telemetry(&[1; 50]);
        for id in 100..105 {
            queue.push_kept(&[id; 200]);
        }
        for _ in 0..100 {
            queue.push_telemetry(&[2; 300]);
        }
        let order: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
        assert_eq!(order[..5], [100, 101, 102, 103, 104]);
        assert!(!queue.overflowed);
    }

    #[test]
    fn a_stalled_link_starts_over_with_the_newest_kept_frame() {
        let mut queue = FrameQueue::new();
        for id in 0..20 {
            queue.push_kept(&[id; 200]);
        }
        assert!(queue.overflowed);
        let order: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
        assert_eq!(order.last(), Some(&19));
    }

    #[test]
    fn a_frame_that_may_wait_costs_no_other_its_place() {
        let mut queue = FrameQueue::new();
        queue.push_kept(&[1; 900]);
        assert!(!queue.push_kept_if_room(&[2; 860]));
        assert_eq!((queue.shed, queue.overflowed), (0, false));
        assert_eq!(pop(&mut queue), Some(1));
        assert!(queue.has_all_room() && queue.push_kept_if_room(&[2; 860]));
        assert_eq!(pop(&mut queue), Some(2));
    }

    #[test]
    fn unsigned_replies_leave_room_for_a_signed_one_and_cost_no_other_its_place() {
        for length in [15, 80, 400, wimu_link::frame::MAX_FRAME] {
            let mut queue = FrameQueue::new();
            queue.push_kept(&[1; 540]);
            for _ in 0..200 {
                queue.push_unsigned(&std::vec![2; length]);
            }
            queue.push_kept(&[3; SIGNED_BYTES - 2]);
            assert_eq!((queue.shed, queue.overflowed), (0, false));
            let order: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
            // As many as there is room for.
            let unsigned = (KEPT_BYTES - SIGNED_BYTES - 542) / (length + 2);
            assert_eq!(order.len(), 1 + unsigned + 1);
            assert_eq!((order[0], order[order.len() - 1]), (1, 3));
        }
    }

    #[test]
    fn what_a_host_needs_at_once_has_room_at_its_longest() {
        let link = LinkStatus {
            frames_sent: u32::MAX,
            bytes_sent: u64::MAX,
            telemetry_shed: u32::MAX,
            frames_damaged: u32::MAX,
            requests_repeated: u32::MAX,
        };
        let [samples, missed, overruns, bus_errors] = [u32::MAX; 4];
        let status = Telemetry::Status(Status {
            uptime_us: u64::MAX,
            cable: Some(link),
            wireless: Some(link),
            sensor: SensorStatus { samples, missed, overruns, bus_errors },
            measured_period_ns: Some(u32::MAX),
            jitter_ns: Some(u32::MAX),
            stack: Some(StackStatus { size: u32::MAX, used: u32::MAX }),
        });
        let wrong_sensor = Event::WrongSensor { expected: 255, found: 255 };
        let event = Telemetry::Event { time_us: u64::MAX, event: wrong_sensor };
        let settings = Telemetry::Settings(Settings {
            rate_hz: u16::MAX,
            gravity_um_s2: u32::MAX,
            ..Settings::default()
        });
        let gyroscope = EpochGyroscope { rad_s_per_lsb: 1e-3, full_scale: i32::MIN };
        let head = Telemetry::Epoch(Epoch {
            sequence: u32::MAX,
            time_us: u64::MAX,
            period_ns: u32::MAX,
            full_scale: i32::MIN,
            parameters: u32::MAX,
            temperature_centi_c: Some(i16::MIN),
            gyroscope: Some(gyroscope),
            ..Epoch::default()
        });
        for (message, most) in
            [(status, STATUS), (event, EVENT), (settings, SETTINGS), (head, EPOCH_HEAD)]
        {
            let mut frame = [0; MAX_FRAME];
            let length = message.encode(&mut frame).expect("room");
            assert!(2 + length <= kept(most), "{message:?}: {length}");
        }
    }

    #[test]
    fn frames_come_out_as_they_went_in_across_the_wrap() {
        let mut queue = FrameQueue::new();
        for round in 0_u32..500 {
            let length = 1 + (round as usize * 37) % 300;
            let sent: std::vec::Vec<u8> = (0..length).map(|i| (i as u32 * round) as u8).collect();
            queue.push_telemetry(&sent);
            assert_eq!(frame(&mut queue), sent);
        }
    }

    #[test]
    fn a_frame_that_has_been_begun_comes_out_whole_whatever_is_shed_behind_it() {
        for first in [65, 130, 400] {
            let mut queue = FrameQueue::new();
            let sent: std::vec::Vec<u8> = (0..first).map(|i| i as u8).collect();
            for _ in 0..3 {
                queue.push_telemetry(&sent);
                let mut piece = [0; PIECE];
                let mut received = std::vec::Vec::new();
                let (length, _) = queue.pop(&mut piece);
                received.extend(&piece[..length]);
                for id in 0..40 {
                    queue.push_telemetry(&[id; 90]);
                    queue.push_kept(&[id; 90]);
                }
                received.extend(frame(&mut queue));
                assert_eq!(received, sent);
                let rest: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
                assert!(rest.contains(&39) && queue.shed > 0);
            }
        }
    }
}
