//! The program `osteotome`.
mod scenario;
mod session;
mod surgeon;
fn main() {}
