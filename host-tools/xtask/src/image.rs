//! Images as boards take them without a probe: Intel HEX for drag and drop onto a micro:bit, UF2 for a Pico.

use std::path::{Path, PathBuf};

use ihex::Record;
use object::LittleEndian;
use object::elf::PT_LOAD;
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Object as _, ObjectSymbol as _};

use crate::Result;

/// Where the files go.
const FOLDER: &str = "target/firmware";
/// Bytes of a line of a HEX file.
const HEX_LINE: usize = 16;
/// Bytes of a block of a UF2 file that carry data.
const UF2_PAGE: usize = 256;
const UF2_FAMILY_RP2040: u32 = 0xe48b_ff56;

/// How a board takes its image.
#[derive(Clone, Copy)]
pub enum Format {
    Hex,
    Uf2,
}

/// Writes the image in the ELF file `elf` as the board in `folder` takes it; says where.
pub fn write(folder: &Path, elf: &Path, format: Format) -> Result<PathBuf> {
    let bytes = std::fs::read(elf).map_err(|error| format!("{}: {error}", elf.display()))?;
    let (start, image) = sealed(&bytes)?;
    let (content, extension) = match format {
        Format::Hex => (hex(start, &image)?.into_bytes(), "hex"),
        Format::Uf2 => (uf2(start, &image), "uf2"),
    };
    let name = folder.file_name().unwrap_or_default();
    let path = Path::new(FOLDER).join(name).with_extension(extension);
    std::fs::create_dir_all(FOLDER)?;
    std::fs::write(&path, content).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(path)
}

/// The loaded segments of an ELF file from the lowest address on, and behind them the two words that
/// `firmware/shared/src/image.rs` checks: "WIMU", and the CRC-32C from the reset vector on. Gaps are erased flash.
fn sealed(elf: &[u8]) -> Result<(u32, Vec<u8>)> {
    let file = ElfFile32::<LittleEndian>::parse(elf)?;
    let mut segments = Vec::new();
    for header in file.elf_program_headers() {
        if header.p_type(LittleEndian) == PT_LOAD && header.p_filesz(LittleEndian) > 0 {
            let data = header.data(LittleEndian, elf).map_err(|()| "a segment is cut off")?;
            segments.push((header.p_paddr(LittleEndian), data));
        }
    }
    segments.sort_by_key(|(address, _)| *address);
    let start = segments.first().ok_or("it is empty")?.0;
    let mut image = Vec::new();
    for (address, data) in segments {
        image.resize((address - start) as usize, 0xFF);
        image.extend_from_slice(data);
    }
    image.resize(image.len().next_multiple_of(4), 0xFF);
    let table = file.symbols().find(|symbol| symbol.name() == Ok("__vector_table"));
    let table = table.ok_or("it has no vector table")?.address() as u32;
    let checked = table.checked_sub(start).and_then(|offset| image.get(offset as usize + 4..));
    let checked = checked.ok_or("its vector table is elsewhere")?;
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(checked);
    image.extend_from_slice(b"WIMU");
    image.extend_from_slice(&crc.to_le_bytes());
    Ok((start, image))
}

fn hex(start: u32, image: &[u8]) -> Result<String> {
    let mut records = Vec::new();
    let mut upper = None;
    let mut address = start;
    let mut rest = image;
    while !rest.is_empty() {
        if upper != Some(address >> 16) {
            upper = Some(address >> 16);
            records.push(Record::ExtendedLinearAddress((address >> 16) as u16));
        }
        // A line does not cross 64 KiB.
        let room = 0x1_0000 - (address as usize & 0xffff);
        let (line, after) = rest.split_at(rest.len().min(HEX_LINE).min(room));
        records.push(Record::Data { offset: address as u16, value: line.to_vec() });
        address += line.len() as u32;
        rest = after;
    }
    records.push(Record::EndOfFile);
    Ok(ihex::create_object_file_representation(&records)?)
}

/// `start` is that of a page.
fn uf2(start: u32, image: &[u8]) -> Vec<u8> {
    let pages = image.chunks(UF2_PAGE);
    let count = pages.len() as u32;
    let mut blocks = Vec::new();
    for (index, page) in (0..).zip(pages) {
        let address = start + index * UF2_PAGE as u32;
        // 0x2000: the last word of the head is a family.
        let head: [u32; 8] = [
            0x0a32_4655,
            0x9e5d_5157,
            0x2000,
            address,
            UF2_PAGE as u32,
            index,
            count,
            UF2_FAMILY_RP2040,
        ];
        let block = blocks.len();
        blocks.extend(head.iter().flat_map(|word| word.to_le_bytes()));
        blocks.extend_from_slice(page);
        blocks.resize(block + 508, 0);
        blocks.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_image_is_refused() {
        for damaged in [&b""[..], b"\x7fELF\x01\x01", &[0; 64]] {
            assert!(sealed(damaged).is_err());
        }
    }

    #[test]
    fn a_hex_file_is_as_the_format_says() {
        assert_eq!(
            hex(0x1_fffe, &[0x21, 0x46, 0x01, 0x36]).unwrap(),
            ":020000040001F9\n:02FFFE0021469A\n:020000040002F8\n:020000000136C7\n:00000001FF\n"
        );
    }

    #[test]
    fn a_uf2_file_holds_whole_pages_and_says_how_many() {
        let blocks = uf2(0x1000_0000, &[1; 259]);
        assert_eq!(blocks.len(), 2 * 512);
        let word = |at: usize| u32::from_le_bytes(blocks[at..at + 4].try_into().expect("four"));
        for (index, address) in [(0, 0x1000_0000), (1, 0x1000_0100)] {
            let at = index * 512;
            assert_eq!(word(at), 0x0a32_4655);
            assert_eq!(word(at + 12), address);
            assert_eq!((word(at + 20), word(at + 24)), (index as u32, 2));
            assert_eq!(word(at + 28), UF2_FAMILY_RP2040);
            assert_eq!(word(at + 508), 0x0ab1_6f30);
        }
        assert_eq!(blocks[512 + 32..512 + 32 + 5], [1, 1, 1, 0, 0]);
    }
}
