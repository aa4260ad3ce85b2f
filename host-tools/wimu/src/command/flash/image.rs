//! Firmware images: ELF, Intel HEX and UF2, and the check that they are for a board.

use crate::arguments::Board;

/// An address and the bytes there.
pub type Segment = (u32, Vec<u8>);

/// Reads an image in any of the formats; `None` if it is damaged or in another format.
pub fn segments(file: &[u8]) -> Option<Vec<Segment>> {
    let found = if file.starts_with(b"\x7fELF") {
        elf(file)
    } else if file.starts_with(b":") {
        hex(std::str::from_utf8(file).ok()?)
    } else {
        uf2(file)
    };
    found.filter(|segments| !segments.is_empty())
}

/// Why an image is not for a board; `None` if it is.
pub fn objection(board: Board, segments: &[Segment]) -> Option<String> {
    let chip = board.chip();
    for (address, bytes) in segments {
        let end = u64::from(*address) + bytes.len() as u64;
        if *address < chip.flash.start || end > u64::from(chip.flash.end) {
            return Some(format!(
                "it has data at {address:#010x}, outside the flash of the {} ({:#010x} to {:#010x})",
                chip.name, chip.flash.start, chip.flash.end
            ));
        }
    }
    let word = |at: u32| {
        let (start, bytes) = segments.iter().find(|(start, bytes)| {
            at >= *start && u64::from(at - start) + 4 <= bytes.len() as u64
        })?;
        let offset = (at - start) as usize;
        Some(u32::from_le_bytes(*bytes.get(offset..)?.first_chunk()?))
    };
    let Some(stack) = word(chip.vectors) else {
        return Some(format!("it has no vector table at {:#010x}", chip.vectors));
    };
    let ram = chip.ram.start + 4..=chip.ram.end;
    (!ram.contains(&stack)).then(|| {
        format!(
            "its stack begins at {stack:#010x}, outside the RAM of the {} ({:#010x} to {:#010x})",
            chip.name, chip.ram.start, chip.ram.end
        )
    })
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn half(bytes: &[u8], at: usize) -> Option<usize> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?).into())
}

/// Loadable segments of a 32-bit ARM ELF file, at their physical addresses.
fn elf(file: &[u8]) -> Option<Vec<Segment>> {
    const ARM: usize = 40;
    const LOADED: u32 = 1;
    if file.get(4..6)? != b"\x01\x01" || half(file, 0x12)? != ARM {
        return None;
    }
    let table = word(file, 0x1c)? as usize;
    let stride = half(file, 0x2a)?;
    let mut segments = Vec::new();
    for index in 0..half(file, 0x2c)? {
        let at = table.checked_add(index * stride)?;
        let offset = word(file, at + 4)? as usize;
        let (address, size) = (word(file, at + 12)?, word(file, at + 16)? as usize);
        if word(file, at)? == LOADED && size > 0 {
            segments.push((address, file.get(offset..offset.checked_add(size)?)?.to_vec()));
        }
    }
    Some(segments)
}

/// Intel HEX: lines of `:LLAAAATT…CC` with a checksum each.
fn hex(text: &str) -> Option<Vec<Segment>> {
    let mut segments: Vec<Segment> = Vec::new();
    let mut upper = 0_u32;
    for line in text.lines().filter(|line| !line.is_empty()) {
        let digits = line.trim_end().strip_prefix(':')?;
        if !digits.is_ascii() || !digits.len().is_multiple_of(2) {
            return None;
        }
        let bytes =
            (0..digits.len() / 2).map(|k| u8::from_str_radix(&digits[2 * k..2 * k + 2], 16));
        let bytes: Vec<u8> = bytes.collect::<Result<_, _>>().ok()?;
        let sum = bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        let [length, high, low, kind, content @ .., _] = &bytes[..] else {
            return None;
        };
        if sum != 0 || content.len() != usize::from(*length) {
            return None;
        }
        match (kind, content) {
            (0, _) => {
                let address = upper.checked_add(u32::from(u16::from_be_bytes([*high, *low])))?;
                match segments.last_mut() {
                    Some((start, bytes))
                        if u64::from(*start) + bytes.len() as u64 == u64::from(address) =>
                    {
                        bytes.extend(content);
                    }
                    _ => segments.push((address, content.to_vec())),
                }
            }
            (1, _) => return Some(segments),
            (2, [high, low]) => upper = u32::from(u16::from_be_bytes([*high, *low])) << 4,
            (4, [high, low]) => upper = u32::from(u16::from_be_bytes([*high, *low])) << 16,
            // The start address is in the vector table.
            (3 | 5, _) => {}
            _ => return None,
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
    use super::*;

    /// Vectors whose stack begins at the end of a chip's memory.
    fn image(board: Board) -> Vec<Segment> {
        let chip = board.chip();
        let mut code = chip.ram.end.to_le_bytes().to_vec();
        code.resize(64, 0xA5);
        vec![(chip.vectors, code)]
    }

    #[test]
    fn an_image_is_for_its_own_board_only() {
        let [first, second] = [Board::MicrobitV2, Board::PicoAdxl345];
        for (own, other) in [(first, second), (second, first)] {
            assert_eq!(objection(own, &image(own)), None);
            let why = objection(other, &image(own)).expect("refused");
            assert!(why.contains(other.chip().name), "{why}");
        }
        // Another chip with flash at the same place has its memory elsewhere, or more of it.
        let mut code = image(first);
        code[0].1[..4].copy_from_slice(&0x2040_0000_u32.to_le_bytes());
        let why = objection(first, &code).expect("refused");
        assert!(why.contains("0x20400000"), "{why}");
        assert!(objection(first, &[(0x100, vec![0; 64])]).is_some(), "no vectors");
    }

    #[test]
    fn hex_lines_are_read_at_their_addresses_and_damage_is_found() {
        let text =
            ":020000040001F9\n:02FFFE0021469A\n:020000040002F8\n:020000000136C7\n:00000001FF\n";
        let expected = vec![(0x1_fffe, vec![0x21, 0x46, 0x01, 0x36])];
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

    #[test]
    fn no_cut_or_damaged_file_panics() {
        let mut file = b"\x7fELF\x01\x01".to_vec();
        file.resize(0x34, 0);
        file[0x12] = 40;
        file[0x1c] = 0x34;
        file[0x2a] = 32;
        file[0x2c] = 1;
        let mut header = Vec::new();
        for word in [1_u32, 0x54, 0, 0x1000_0100, 4, 4, 5, 4] {
            header.extend(word.to_le_bytes());
        }
        file.extend(header);
        file.extend(b"code");
        assert_eq!(segments(&file), Some(vec![(0x1000_0100, b"code".to_vec())]));
        for cut in 0..file.len() {
            assert_eq!(segments(&file[..cut]), None, "{cut}");
        }
        for at in 0..file.len() {
            file[at] ^= 0xFF;
            let _ = segments(&file);
            file[at] ^= 0xFF;
        }
    }
}
