//! Firmware images: Intel HEX and UF2, and the check that they are for a board.

use ihex::Record;

use super::Facts;

/// An address and the bytes there.
pub type Segment = (u32, Vec<u8>);

/// Reads an image in either format; `None` if it is damaged or in another format.
pub fn segments(file: &[u8]) -> Option<Vec<Segment>> {
    let found =
        if file.starts_with(b":") { hex(std::str::from_utf8(file).ok()?) } else { uf2(file) };
    found.filter(|segments| !segments.is_empty())
}

/// Why an image is not for a board; `None` if it is.
pub fn objection(board: &Facts, file: &[u8], segments: &[Segment]) -> Option<String> {
    let family = if file.starts_with(b":") { None } else { word(file, 28) };
    if family != board.family {
        return Some("its format or its UF2 family is that of another board".into());
    }
    let Facts { chip, stack, vectors, .. } = board;
    let in_segment = |(start, bytes): &Segment| word(bytes, vectors.checked_sub(*start)? as usize);
    let Some(first) = segments.iter().find_map(in_segment) else {
        return Some(format!("it has no vector table at {vectors:#010x}"));
    };
    (!stack.contains(&first)).then(|| {
        let end = stack.end();
        format!(
            "its stack begins at {first:#010x}, outside the RAM of the {chip} (up to {end:#010x})"
        )
    })
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// Intel HEX: a segment for each line.
fn hex(text: &str) -> Option<Vec<Segment>> {
    let (mut segments, mut upper) = (Vec::new(), 0_u32);
    for record in ihex::Reader::new(text) {
        match record.ok()? {
            Record::Data { offset, value } => {
                segments.push((upper.checked_add(offset.into())?, value))
            }
            Record::EndOfFile => return Some(segments),
            Record::ExtendedSegmentAddress(high) => upper = u32::from(high) << 4,
            Record::ExtendedLinearAddress(high) => upper = u32::from(high) << 16,
            // The start address is in the vector table.
            Record::StartSegmentAddress { .. } | Record::StartLinearAddress(_) => {}
        }
    }
    // The end record is missing.
    None
}

/// UF2: blocks of 512 bytes.
fn uf2(file: &[u8]) -> Option<Vec<Segment>> {
    const BLOCK: usize = 512;
    if file.is_empty() || !file.len().is_multiple_of(BLOCK) {
        return None;
    }
    let mut segments = Vec::new();
    for block in file.chunks(BLOCK) {
        let marks = [0, 4, 508].map(|at| word(block, at));
        if marks != [Some(0x0a32_4655), Some(0x9e5d_5157), Some(0x0ab1_6f30)] {
            return None;
        }
        let (address, size) = (word(block, 12)?, word(block, 16)? as usize);
        segments.push((address, block.get(32..32 + size.min(476))?.to_vec()));
    }
    (segments.len() == word(file, 24)? as usize).then_some(segments)
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum as _;

    use super::*;
    use crate::arguments::Board;

    /// Vectors whose stack begins at the end of a chip's memory.
    fn image(board: &Facts) -> (Vec<u8>, Vec<Segment>) {
        let mut code = board.stack.end().to_le_bytes().to_vec();
        code.resize(64, 0xA5);
        let mut file = vec![0; 32];
        match board.family {
            Some(family) => file[28..].copy_from_slice(&family.to_le_bytes()),
            None => file[0] = b':',
        }
        (file, vec![(board.vectors, code)])
    }

    #[test]
    fn an_image_is_for_its_own_board_only() {
        let boards = Board::value_variants();
        for own in boards.iter().map(|board| board.facts()) {
            let (file, segments) = image(&own);
            assert_eq!(objection(&own, &file, &segments), None);
            for other in boards.iter().map(|board| board.facts()) {
                let found = objection(&other, &file, &segments);
                assert_eq!(found.is_none(), other.name == own.name, "{}", other.name);
            }
            // Another chip with flash at the same place has its memory elsewhere, or more of it.
            let stack = 0x2040_0000_u32.to_le_bytes();
            let why = objection(&own, &file, &[(own.vectors, stack.to_vec())]).expect("refused");
            assert!(why.contains("0x20400000"), "{why}");
            assert!(
                objection(&own, &file, &[(own.vectors + 4, vec![0; 64])]).is_some(),
                "no vectors"
            );
        }
    }

    #[test]
    fn hex_lines_are_read_at_their_addresses_and_damage_is_found() {
        let text =
            ":020000040001F9\n:02FFFE0021469A\n:020000040002F8\n:020000000136C7\n:00000001FF\n";
        let expected = vec![(0x1_fffe, vec![0x21, 0x46]), (0x2_0000, vec![0x01, 0x36])];
        assert_eq!(segments(text.as_bytes()), Some(expected));
        for damaged in [
            &text[..text.len() - 13],
            &text.replace("2146", "2147"),
            &text.replace("9A", "9"),
            ":\n",
            ":xx\n",
            "",
        ] {
            assert_eq!(segments(damaged.as_bytes()), None, "{damaged}");
        }
    }

    #[test]
    fn uf2_blocks_are_read_and_a_missing_one_is_found() {
        let block = |index: u32| {
            let mut block = vec![0; 512];
            let words = [
                (0, 0x0a32_4655),
                (4, 0x9e5d_5157),
                (12, 0x1000_0000 + 256 * index),
                (16, 256),
                (20, index),
                (24, 2),
                (508, 0x0ab1_6f30),
            ];
            for (at, word) in words {
                block[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
            }
            block
        };
        let file = [block(0), block(1)].concat();
        let found = segments(&file).expect("an image");
        let at: Vec<u32> = found.iter().map(|(address, _)| *address).collect();
        assert_eq!(at, [0x1000_0000, 0x1000_0100]);
        assert_eq!(segments(&file[..512]), None);
        assert_eq!(segments(&file[..700]), None);
    }
}
