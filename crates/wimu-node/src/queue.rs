//! Frames that wait for a link.

use wimu_link::frame::MAX_FRAME;

/// Bytes for frames that may be shed when the link is too slow.
const TELEMETRY_BYTES: usize = 2048;
/// Bytes for frames that may not: epochs, replies, Hello, parameters.
const KEPT_BYTES: usize = 3072;

/// What waits for one link: telemetry, of which the oldest is shed when room runs out, and frames
/// that are kept, which go first.
#[derive(Default)]
pub(crate) struct FrameQueue {
    kept: Ring<KEPT_BYTES>,
    telemetry: Ring<TELEMETRY_BYTES>,
    /// Telemetry frames shed so far.
    pub(crate) shed: u32,
    pub(crate) frames_sent: u32,
    pub(crate) bytes_sent: u64,
    /// Kept frames that had no room since the link last drained: it has stalled.
    pub(crate) overflowed: bool,
    /// A frame has been taken and is not over the line yet.
    pub(crate) sending: bool,
}

impl FrameQueue {
    /// Queues a frame that may be shed.
    pub(crate) fn push_telemetry(&mut self, frame: &[u8]) {
        while !self.telemetry.push(frame) {
            if !self.telemetry.drop_oldest() {
                return;
            }
            self.shed = self.shed.saturating_add(1);
        }
    }

    /// Queues a frame that may not be shed. On a link that has stalled for so long that there is
    /// no room, everything is dropped and counted, and the link starts over when it drains.
    pub(crate) fn push_kept(&mut self, frame: &[u8]) {
        if self.kept.push(frame) {
            return;
        }
        self.overflowed = true;
        while self.kept.drop_oldest() || self.telemetry.drop_oldest() {
            self.shed = self.shed.saturating_add(1);
        }
        self.kept.push(frame);
    }

    /// Whether no kept frame waits or is being sent.
    pub(crate) fn is_drained(&self) -> bool {
        self.kept.oldest() == 0 && !self.sending
    }

    /// Takes the next frame to send; 0 if none waits.
    pub(crate) fn pop(&mut self, frame: &mut [u8; MAX_FRAME]) -> usize {
        let length = match self.kept.pop(frame) {
            0 => self.telemetry.pop(frame),
            length => length,
        };
        if length > 0 {
            self.sending = true;
            self.frames_sent = self.frames_sent.wrapping_add(1);
            self.bytes_sent = self.bytes_sent.wrapping_add(length as u64);
        }
        length
    }
}

/// Frames in a ring of bytes, each behind its length.
struct Ring<const N: usize> {
    bytes: [u8; N],
    start: usize,
    used: usize,
}

impl<const N: usize> Default for Ring<N> {
    fn default() -> Self {
        Self {
            bytes: [0; N],
            start: 0,
            used: 0,
        }
    }
}

impl<const N: usize> Ring<N> {
    /// Appends a frame if there is room.
    fn push(&mut self, frame: &[u8]) -> bool {
        let Ok(length) = u16::try_from(frame.len()) else {
            return false;
        };
        if frame.is_empty() || self.used + 2 + frame.len() > N {
            return false;
        }
        self.append(&length.to_le_bytes());
        self.append(frame);
        true
    }

    /// Removes the oldest frame into `frame`; 0 if there is none.
    fn pop(&mut self, frame: &mut [u8; MAX_FRAME]) -> usize {
        let length = self.oldest();
        let length = length.min(frame.len());
        if length > 0 {
            self.skip(2);
            for byte in &mut frame[..length] {
                *byte = self.bytes[self.start];
                self.skip(1);
            }
        }
        length
    }

    fn drop_oldest(&mut self) -> bool {
        let length = self.oldest();
        if length > 0 {
            self.skip(2 + length);
        }
        length > 0
    }

    fn oldest(&self) -> usize {
        if self.used == 0 {
            return 0;
        }
        let low = self.bytes[self.start];
        let high = self.bytes[(self.start + 1) % N];
        usize::from(u16::from_le_bytes([low, high]))
    }

    fn append(&mut self, bytes: &[u8]) {
        let end = (self.start + self.used) % N;
        let (before_wrap, after_wrap) = bytes.split_at(bytes.len().min(N - end));
        self.bytes[end..end + before_wrap.len()].copy_from_slice(before_wrap);
        self.bytes[..after_wrap.len()].copy_from_slice(after_wrap);
        self.used += bytes.len();
    }

    fn skip(&mut self, bytes: usize) {
        self.start = (self.start + bytes) % N;
        self.used -= bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pop(queue: &mut FrameQueue) -> Option<u8> {
        let mut frame = [0; MAX_FRAME];
        (queue.pop(&mut frame) > 0).then_some(frame[0])
    }

    #[test]
    fn the_oldest_telemetry_is_shed_first_and_counted() {
        let mut queue = FrameQueue::default();
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
        let mut queue = FrameQueue::default();
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
        let mut queue = FrameQueue::default();
        for id in 0..20 {
            queue.push_kept(&[id; 200]);
        }
        assert!(queue.overflowed);
        let order: std::vec::Vec<u8> = core::iter::from_fn(|| pop(&mut queue)).collect();
        assert_eq!(order.last(), Some(&19));
    }

    #[test]
    fn frames_come_out_as_they_went_in_across_the_wrap() {
        let mut queue = FrameQueue::default();
        let mut frame = [0; MAX_FRAME];
        for round in 0_u32..500 {
            let length = 1 + (round as usize * 37) % 300;
            let sent: std::vec::Vec<u8> = (0..length).map(|i| (i as u32 * round) as u8).collect();
            queue.push_telemetry(&sent);
            let received = queue.pop(&mut frame);
            assert_eq!(frame[..received], sent);
        }
    }
}
