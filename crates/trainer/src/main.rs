//! The program `osteotome`.

fn main() -> std::process::ExitCode {
    osteotome::cli::main()
}
