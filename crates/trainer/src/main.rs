//! The program `osteotome`.
mod cli;
mod commands;
mod engine;
mod fracture;
mod input;
mod loops;
mod picture;
mod render_command;
mod scenario;
mod session;
mod surgeon;
mod talk;
mod verify;

fn main() -> std::process::ExitCode {
    cli::main()
}
