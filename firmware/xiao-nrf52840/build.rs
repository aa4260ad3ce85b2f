//! Linker arguments, and where flash and RAM are.

#[path = "../shared/link.rs"]
mod link;

fn main() {
    // `--icf=all`: functions with the same code exist once.
    let mut arguments = vec!["--nmagic", "--icf=all", "-Tlink.x"];
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        arguments.push("-Tdefmt.x");
    }
    link::link(include_str!("memory.x"), &arguments);
}
