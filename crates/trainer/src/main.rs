//! The program `osteotome`.
mod input;
mod loops;
mod scenario;
mod session;
mod surgeon;
fn main() {}
