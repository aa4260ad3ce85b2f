//! Assembly of parameter sets that travel in pieces.

use wimu_link::message::{ActiveParameters, EncodedParameters, MessageError, ParametersPiece};

/// The pieces of a parameter set, up to the first that is missing.
#[derive(Debug, Default)]
pub struct Pieces {
    id: u32,
    total: u16,
    bytes: Vec<u8>,
}

impl Pieces {
    /// Number of bytes received without a gap: the offset of the next piece.
    pub fn received(&self) -> u16 {
        self.bytes.len() as u16
    }

    /// Takes a piece; returns the set when its last one arrives. A piece of another set begins anew; one after
    /// a missing piece is left out.
    ///
    /// # Errors
    /// [`MessageError`] when the set is not one that this version reads, or was damaged.
    pub fn take(
        &mut self,
        piece: &ParametersPiece,
    ) -> Result<Option<ActiveParameters>, MessageError> {
        if (self.id, self.total) != (piece.id, piece.total) {
            (self.id, self.total) = (piece.id, piece.total);
            self.bytes.clear();
        }
        let (content, start) = (piece.piece.as_bytes(), usize::from(piece.offset));
        let known = self.bytes.len().saturating_sub(start);
        if start <= self.bytes.len() {
            self.bytes.extend(content.iter().skip(known));
        }
        let total = usize::from(self.total);
        if self.bytes.len() < total || start + content.len() < total {
            return Ok(None);
        }
        let set = EncodedParameters(&self.bytes);
        let active = match total {
            0 => Ok(None),
            _ if self.bytes.len() > total || set.id().0 != self.id => Err(MessageError::Malformed),
            _ => set.decode().map(Some),
        };
        if active.is_err() {
            self.bytes.clear();
        }
        let id = self.id;
        active.map(|active| Some(ActiveParameters { id, active }))
    }
}
