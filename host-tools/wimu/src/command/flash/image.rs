//! Formats of firmware images.

use std::fmt;

use ihex::Record;

/// Format of an image. A UF2 file names the family of chips that it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Hex,
    Uf2 { family: u32 },
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hex => f.write_str("Intel HEX"),
            Self::Uf2 { family } => write!(f, "UF2 of family {family:#010x}"),
        }
    }
}

/// The format of a file; `None` if it is damaged or no image.
pub fn format(file: &[u8]) -> Option<Format> {
    if !file.starts_with(b":") {
        return uf2(file);
    }
    let records: Result<Vec<Record>, _> = ihex::Reader::new(str::from_utf8(file).ok()?).collect();
    let is_whole = records.ok()?.last() == Some(&Record::EndOfFile);
    is_whole.then_some(Format::Hex)
}

/// UF2: blocks of 512 bytes, each with the number of all and the family.
/// <https://github.com/microsoft/uf2>
fn uf2(file: &[u8]) -> Option<Format> {
    let (blocks, []) = file.as_chunks::<512>() else { return None };
    let word =
        |block: &[u8; 512], at: usize| Some(u32::from_le_bytes(*block.get(at..)?.first_chunk()?));
    let marks = [(0, 0x0a32_4655), (4, 0x9e5d_5157), (508, 0x0ab1_6f30)];
    let family = word(blocks.first()?, 28)?;
    let count = u32::try_from(blocks.len()).ok()?;
    let belongs = |block| {
        let [blocks, family_there] = [24, 28].map(|at| word(block, at));
        marks.iter().all(|&(at, mark)| word(block, at) == Some(mark))
            && blocks == Some(count)
            && family_there == Some(family)
    };
    blocks.iter().all(belongs).then_some(Format::Uf2 { family })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hex_file_without_its_end_or_with_a_wrong_sum_is_no_image() {
        let text =
            ":020000040001F9\n:02FFFE0021469A\n:020000040002F8\n:020000000136C7\n:00000001FF\n";
        assert_eq!(format(text.as_bytes()), Some(Format::Hex));
        for damaged in [
            &text[..text.len() - 13],
            &text.replace("2146", "2147"),
            &text.replace("9A", "9"),
            ":\n",
            ":xx\n",
            "",
        ] {
            assert_eq!(format(damaged.as_bytes()), None, "{damaged}");
        }
    }

    #[test]
    fn a_uf2_file_with_a_missing_or_foreign_block_is_no_image() {
        let block = |family: u32| {
            let mut block = vec![0; 512];
            let words =
                [(0, 0x0a32_4655), (4, 0x9e5d_5157), (24, 2), (28, family), (508, 0x0ab1_6f30)];
            for (at, word) in words {
                block[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
            }
            block
        };
        let file = [block(7), block(7)].concat();
        assert_eq!(format(&file), Some(Format::Uf2 { family: 7 }));
        for damaged in [&file[..512], &file[..700], &[block(7), block(8)].concat()] {
            assert_eq!(format(damaged), None);
        }
    }
}
