//! Simulated boards of the cases.

use std::io::Write;
use std::sync::mpsc;
use std::{io, thread};

use serde_json::Value;
use wimu::{Output, run};

use crate::words;

/// A simulated board that runs until this process ends.
pub struct Board {
    pub cable: String,
    pub wireless: String,
}

impl Board {
    pub fn start(options: &str) -> Self {
        /// Passes each line on.
        struct Lines(mpsc::Sender<String>);

        impl Write for Lines {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                let _ = self.0.send(String::from_utf8_lossy(bytes).into_owned());
                Ok(bytes.len())
            }

            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }

        let line = format!("simulate --cable 127.0.0.1:0 --wireless 127.0.0.1:0 {options}");
        let (sender, receiver) = mpsc::channel();
        thread::spawn(move || run(words(&line), &mut Output::to(Lines(sender), io::sink())));
        let first = receiver.recv().expect("the links");
        let envelope: Value = serde_json::from_str(&first).expect("an object");
        let link = |name: &str| envelope["data"][name].as_str().expect("a LINK").to_owned();
        Self { cable: link("cable"), wireless: link("wireless") }
    }
}
