//! What a channel did, known to the test and hidden from the host.

/// What became of everything that was sent in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FaultCounts {
    /// Bytes that the sender put on the line.
    pub bytes_sent: u64,
    /// Bytes that arrived or will, added ones included.
    pub bytes_delivered: u64,
    /// Bytes lost in runs.
    pub bytes_lost: u64,
    /// Bytes lost because the adapter's buffer was full.
    pub bytes_overflowed: u64,
    /// Bytes lost because there was no connection.
    pub bytes_disconnected: u64,
    /// Bits flipped.
    pub bits_flipped: u64,
    /// Earlier bytes that came in between.
    pub bytes_spliced: u64,
    /// Bytes that came again.
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

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It arrived as it was sent, and what arrived before it ended with a zero.
    Intact,
    /// It arrived as it was sent, but without a zero before it: it cannot be told from the rubble of
    /// the one before.
    Fused,
    /// Bytes of it are missing or changed, or others are in between.
    Damaged,
    /// No byte of it arrived.
    Lost,
}

/// A frame that was sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameTruth {
    /// As sent, with its closing zero.
    pub bytes: Vec<u8>,
    /// When its last byte came off the sender's line, ns since the simulation's start.
    pub sent_ns: u64,
    /// When that byte reached the receiver, if it did, on the same clock.
    pub delivered_ns: Option<u64>,
    /// What became of it.
    pub fate: Fate,
}
