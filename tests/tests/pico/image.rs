//! What is where in the image, from its ELF file.

use wimu_link::hello::Fault;

const SYMBOLS: u32 = 2;

/// The image as the linker left it.
pub struct Image(Vec<u8>);

/// What a panic of the image's own would tell, and where that is kept.
pub struct Place {
    pub address: u32,
    pub fault: Fault,
}

impl Image {
    /// That of `cargo xtask release --only pico`.
    pub fn read() -> Self {
        let path =
            std::env::var("WIMU_PICO_ELF").expect("`cargo xtask release --only pico` says it");
        let elf = std::fs::read(path).expect("readable");
        assert_eq!(elf[..6], *b"\x7fELF\x01\x01");
        Self(elf)
    }

    fn word(&self, at: usize) -> u32 {
        u32::from_le_bytes(*self.0[at..].first_chunk().expect("it goes on"))
    }

    fn half(&self, at: usize) -> usize {
        usize::from(u16::from_le_bytes(*self.0[at..].first_chunk().expect("it goes on")))
    }

    /// The offset of section `index`'s header.
    fn section(&self, index: usize) -> usize {
        self.word(0x20) as usize + index * self.half(0x2E)
    }

    /// The address of the one function in whose mangled name `part` is.
    pub fn function(&self, part: &str) -> u32 {
        let sections = (0..self.half(0x30)).map(|index| self.section(index));
        let table =
            sections.clone().find(|section| self.word(section + 4) == SYMBOLS).expect("symbols");
        let [start, size, names] =
            [table + 16, table + 20, self.section(self.word(table + 24) as usize) + 16]
                .map(|at| self.word(at) as usize);
        let mut found = (start..start + size).step_by(16).filter(|&at| {
            let name = &self.0[names + self.word(at) as usize..];
            let end = name.iter().position(|&byte| byte == 0).expect("an end");
            name[..end].windows(part.len()).any(|w| w == part.as_bytes())
        });
        let symbol = found.next().unwrap_or_else(|| panic!("no {part}"));
        assert!(found.next().is_none(), "several {part}");
        self.word(symbol + 4)
    }

    /// What is in the flash at `address`.
    fn memory(&self, address: u32, length: u32) -> Option<&[u8]> {
        let header = |index| self.word(0x1C) as usize + index * self.half(0x2A);
        (0..self.half(0x2C)).map(header).find_map(|header| {
            let [offset, start, size] = [4, 8, 16].map(|field| self.word(header + field));
            let inside = address.checked_sub(start)?;
            let at = (inside.checked_add(length)? <= size).then_some(offset + inside)? as usize;
            self.0.get(at..at + length as usize)
        })
    }

    /// A place in `file` at which the image can panic: `&'static Location`, a string and two numbers.
    pub fn place_in(&self, file: &str) -> Place {
        let numbers = |bytes: &[u8]| {
            let words = bytes.chunks_exact(4);
            let mut words = words.map(|word| u32::from_le_bytes(word.try_into().expect("four")));
            [(); 4].map(|()| words.next().expect("four of them"))
        };
        (0x1000_0000..0x1010_0000_u32)
            .step_by(4)
            .find_map(|address| {
                let [text, length, line, column] = numbers(self.memory(address, 16)?);
                let is_text = (3..256).contains(&length) && line < 10_000 && column < 200;
                let text = is_text.then(|| self.memory(text, length))??;
                let text = std::str::from_utf8(text).ok()?;
                text.ends_with(file).then(|| Place { address, fault: Fault::panic(text, line) })
            })
            .unwrap_or_else(|| panic!("it cannot panic in {file}"))
    }
}
