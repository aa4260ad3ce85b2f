//! All integration tests of `wimu-tests` in one binary: one module a file.

#[path = "board/main.rs"]
mod board;
mod first_light;
mod from_the_document;
mod fuzz;
mod noisy_link;
#[path = "pico/main.rs"]
mod pico;
mod pico_mpu6050;
mod pushes;
#[path = "qemu/main.rs"]
mod qemu;
mod real_input;
#[path = "store/main.rs"]
mod store;
mod wire;
