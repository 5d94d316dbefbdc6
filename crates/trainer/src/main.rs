//! The program `osteotome`.
mod cli;
mod commands;
mod devices;
mod engine;
mod fracture;
mod input;
mod loops;
mod scenario;
mod session;
mod surgeon;
mod talk;
mod verify;

fn main() -> std::process::ExitCode {
    cli::main()
}
