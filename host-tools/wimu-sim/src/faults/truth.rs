//! The true effect of a channel, unknown to the host.

/// Statistics of one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FaultCounts {
    /// Bytes sent.
    pub bytes_sent: u64,
    /// Bytes delivered or under way, including added ones.
    pub bytes_delivered: u64,
    /// Bytes lost in runs.
    pub bytes_lost: u64,
    /// Bytes lost because the adapter's buffer was full.
    pub bytes_overflowed: u64,
    /// Bytes lost because there was no connection.
    pub bytes_disconnected: u64,
    /// Bits flipped.
    pub bits_flipped: u64,
    /// Inserted earlier bytes.
    pub bytes_spliced: u64,
    /// Repeated bytes.
    pub bytes_duplicated: u64,
    /// Frames sent, by their [`Fate`].
    pub frames_intact: u64,
    /// See [`Fate::Fused`].
    pub frames_fused: u64,
    /// See [`Fate::Damaged`].
    pub frames_damaged: u64,
    /// See [`Fate::Lost`].
    pub frames_lost: u64,
}

/// Result of the transmission of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It arrived unchanged, after a zero.
    Intact,
    /// It arrived unchanged, but without a zero before it, so that it cannot be separated from the damaged frame before it.
    Fused,
    /// Some of its bytes are missing, changed or separated by others.
    Damaged,
    /// None of its bytes arrived.
    Lost,
}

/// A frame that was sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameTruth {
    /// As sent, with its closing zero.
    pub bytes: Vec<u8>,
    /// Time of its last byte at the end of the sender's line, ns since the simulation's start.
    pub sent_ns: u64,
    /// Time of arrival of that byte, if it arrived, on the same clock.
    pub delivered_ns: Option<u64>,
    /// Result of the transmission.
    pub fate: Fate,
}
