//! What is where in the image, from its ELF file.

const SYMBOLS: u32 = 2;

/// The image as the linker left it.
pub struct Image(Vec<u8>);

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
}
