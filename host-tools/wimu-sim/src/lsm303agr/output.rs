//! Output registers with their status.

/// Output registers of `N` channels, low byte first, with "new data" and "overrun" per channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Output<const N: usize>([Channel; N]);

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    /// What the register shows.
    shown: i16,
    /// A newer value that block data update keeps out of the register for now.
    held_back: Option<i16>,
    /// Which byte of `shown` was read without the other: `true` for the high one.
    half_read: Option<bool>,
    fresh: bool,
    overrun: bool,
}

impl<const N: usize> Output<N> {
    pub(super) fn new() -> Self {
        Self([Channel::default(); N])
    }

    /// Takes a sample for the channels that are on. With `block_update`, a register of which one
    /// byte was read keeps its value until the other is read too.
    pub(super) fn store(&mut self, values: [i16; N], on: [bool; N], block_update: bool) {
        for ((channel, value), _) in self.0.iter_mut().zip(values).zip(on).filter(|(_, on)| *on) {
            if block_update && channel.half_read.is_some() {
                channel.overrun |= channel.held_back.is_some();
                channel.held_back = Some(value);
            } else {
                channel.overrun |= channel.fresh;
                channel.fresh = true;
                channel.shown = value;
            }
        }
    }

    /// Reads byte `byte` (0..2 N) of the registers. A channel's high byte ends its "new data".
    pub(super) fn read(&mut self, byte: u8, big_endian: bool) -> u8 {
        let Some(channel) = self.0.get_mut(usize::from(byte / 2)) else {
            return 0;
        };
        let high = (byte % 2 == 1) != big_endian;
        let [low_byte, high_byte] = channel.shown.to_le_bytes();
        if high {
            channel.fresh = false;
            channel.overrun = false;
        }
        if channel.half_read == Some(!high) {
            channel.half_read = None;
            if let Some(value) = channel.held_back.take() {
                channel.shown = value;
                channel.fresh = true;
            }
        } else {
            channel.half_read = Some(high);
        }
        if high { high_byte } else { low_byte }
    }

    /// Whether any channel has new data.
    pub(super) fn fresh(&self) -> bool {
        self.0.iter().any(|channel| channel.fresh)
    }

    /// Whether any channel lost data.
    pub(super) fn overrun(&self) -> bool {
        self.0.iter().any(|channel| channel.overrun)
    }

    /// The status register of three channels: ZYXOR, ZOR, YOR, XOR, ZYXDA, ZDA, YDA, XDA.
    pub(super) fn status(&self) -> u8 {
        let mut status = u8::from(self.overrun()) << 7 | u8::from(self.fresh()) << 3;
        for (axis, channel) in self.0.iter().enumerate() {
            status |= u8::from(channel.fresh) << axis | u8::from(channel.overrun) << (axis + 4);
        }
        status
    }
}
