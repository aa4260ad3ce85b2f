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

#[cfg(test)]
mod tests {
    use wimu_link::Telemetry;
    use wimu_link::message::{Piece, WireGyroscope, WireParameters};
    use wimu_model::{GyroscopeModel, GyroscopeParameters, ParameterSet, Sensitivity};

    use super::super::{Decoder, Event};
    use super::*;

    /// A set of three pieces.
    fn set(bias: f64) -> WireParameters {
        let sensitivity = Sensitivity::from_lsb_per_g(16384.0).unwrap();
        let model = GyroscopeModel::default();
        let gyroscope = GyroscopeParameters::new(500, 0.0003, model, Some([0.01; 12])).unwrap();
        let mut wire = WireParameters::from(&ParameterSet::uncalibrated(2, sensitivity));
        wire.gyroscope = Some(WireGyroscope::from(&gyroscope));
        wire.bias_mps2[0] = bias;
        wire
    }

    fn pieces(set: &WireParameters) -> Vec<ParametersPiece> {
        let mut bytes = [0; WireParameters::MAX];
        let length = set.encode(&mut bytes).unwrap();
        let set = EncodedParameters(&bytes[..length]);
        let offsets = (0..length).step_by(Piece::MAX);
        offsets.map(|offset| set.piece(set.id(), offset as u16)).collect()
    }

    fn heard(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Option<WireParameters>> {
        let mut sets = Vec::new();
        decoder.push(0, bytes, |arrival| match arrival.event {
            Event::Parameters(parameters) => sets.push(parameters.active),
            Event::Damaged(error) => panic!("{error}"),
            _ => {}
        });
        sets
    }

    fn sent(pieces: &[ParametersPiece]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for piece in pieces {
            let mut frame = [0; wimu_link::MAX_FRAME];
            let length = <Telemetry>::ParametersPiece(*piece).encode(&mut frame);
            bytes.extend(&frame[..length.unwrap()]);
        }
        bytes
    }

    #[test]
    fn a_set_is_that_of_all_its_pieces_and_the_latest_complete_one_counts() {
        let [old, new] = [set(0.1), set(0.2)];
        let [a, b] = [old, new].map(|set| pieces(&set));
        assert_eq!((a.len(), b.len()), (3, 3));
        let mut decoder = Decoder::new();
        let heard = |pieces: &[ParametersPiece], decoder: &mut _| heard(decoder, &sent(pieces));
        assert_eq!(heard(&a, &mut decoder), [Some(old)]);
        // Incomplete, then changed.
        assert_eq!(heard(&b[..2], &mut decoder), []);
        assert_eq!(heard(&a, &mut decoder), [Some(old)]);
        // The second piece is lost, then it comes when all are sent again.
        assert_eq!(heard(&[b[0], b[2]], &mut decoder), []);
        assert_eq!(heard(&b, &mut decoder), [Some(new)]);
        // Two sets mixed, and repeated pieces.
        assert_eq!(heard(&[a[0], b[1], b[2]], &mut decoder), []);
        let repeated = [a[0], a[0], a[1], a[0], a[1], a[2]];
        assert_eq!(heard(&repeated, &mut decoder), [Some(old)]);
    }

    #[test]
    fn pieces_that_are_no_set_are_unreadable_and_do_no_harm() {
        let mut decoder = Decoder::new();
        let good = pieces(&set(0.1));
        let other_id = good.iter().map(|piece| ParametersPiece { id: 7, ..*piece });
        let beyond = [ParametersPiece { total: 100, ..good[0] }];
        for pieces in [other_id.collect::<Vec<_>>(), beyond.into()] {
            let mut complaints = 0;
            decoder.push(0, &sent(&pieces), |arrival| {
                complaints += u32::from(matches!(arrival.event, Event::Unreadable(_)));
            });
            assert_eq!(complaints, 1);
        }
        assert_eq!(heard(&mut decoder, &sent(&good)), [Some(set(0.1))]);
    }

    /// Recordings of version 1 hold whole sets, those of version 2 pieces.
    #[test]
    fn sets_of_both_versions_are_read() {
        for (text, expected) in [
            (include_str!("../../../../tests/vectors/v1/telemetry.hex"), 3),
            (include_str!("../../../../tests/vectors/v2/telemetry.hex"), 4),
        ] {
            let frames = text.lines().filter(|line| !line.starts_with('#'));
            let bytes: Vec<u8> = frames
                .flat_map(|line| {
                    let digits = line.as_bytes().chunks(2);
                    digits.map(|pair| {
                        u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()
                    })
                })
                .collect();
            let mut sets = heard(&mut Decoder::new(), &bytes);
            assert_eq!(sets.len(), expected);
            sets.retain(Option::is_some);
            assert_eq!(sets.len(), 2);
        }
    }
}
