//! The program `osteotome` as a library: its binary and its benches share it. Nothing outside the workspace relies on it.
pub mod cli;
mod commands;
mod debrief;
mod devices;
pub mod engine;
mod fracture;
pub mod input;
pub mod loops;
mod picture;
mod prepare_command;
mod render_command;
mod report_command;
pub mod scenario;
pub mod session;
pub mod surgeon;
mod talk;
mod verify;
mod window;
