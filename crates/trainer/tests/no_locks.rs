//! No way through a tick of the haptic loop leads to a lock, a wait or a system call other than a look at the clock.
//!
//! An uncontended lock makes no system call and leaves no trace, so a run shows nothing. But to take a lock a processor must
//! compare and swap. This test reads the machine code of the program itself, from `HapticLoop::tick` (plan, read the devices, step,
//! write) and the methods of a device's link on through every call, taken in some run or not, and finds there
//! no atomic instruction but the swaps of one byte by which a triple buffer changes hands, and a reference given back,
//! no call out of the program but those below, and no call to what it cannot name but a device's methods.
//! Not followed are panics, and the allocator and what gives memory back, which `tests/no_allocation.rs` shows is never asked in the
//! step. A call through a register counts as one of all that its function loads into it from the table of addresses.
//!
//! Needs `objdump`, which comes with the C compiler.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};

/// Of the C library: pure, but for the clock and the unwinder, which only a panic reaches.
const HARMLESS: &str = "memcpy memmove memset memcmp bcmp acos asin atan atan2 cos cosh exp exp2 expm1 fma fmod hypot log log1p \
    pow sin sincos sinh tan tanh clock_gettime __errno_location _Unwind_Resume";

/// Where the walk ends: panics, the allocator, glue that gives back what is on the heap, and what binds names when they are first
/// used, which is not so in a program whose names are bound when it is loaded.
const NOT_FOLLOWED: &[&str] = &[
    "9panicking",
    "handle_alloc_error",
    "__rust_alloc",
    "__rust_dealloc",
    "__rust_realloc",
    "drop_in_place",
    "@plt-0x10",
];

/// What matters of an instruction.
enum Step {
    /// A call or jump to an address.
    To(u64),
    /// Through a place in the table of addresses.
    Through(u64),
    /// To what a register holds: a call, or a jump.
    Register(String, bool),
    /// To what lies anywhere in memory.
    Unknown,
    /// A place in the table of addresses is loaded into a register.
    Load(String, u64),
    /// From one register into another.
    Copy(String, String),
    /// A jump table is read.
    Table,
    /// Exchanges with memory.
    Swap,
    /// Any other atomic instruction, or a system call.
    Forbidden,
}

#[derive(Default)]
struct Function {
    name: String,
    steps: Vec<(Step, String)>,
}

/// A program's functions by address, and what the loader puts into its table of addresses.
struct Program {
    functions: BTreeMap<u64, Function>,
    table: HashMap<u64, Target>,
}

enum Target {
    Local(u64),
    Import(String),
}

fn hex(text: &str) -> Option<u64> {
    u64::from_str_radix(text.trim_start_matches("0x"), 16).ok()
}

/// Of `call   *0x3f2cdb(%rip)        # 1a72160 <memset@GLIBC_2.2.5>`.
fn place(text: &str) -> Option<u64> {
    hex(text.split("# ").nth(1)?.split(' ').next()?)
}

fn step(text: &str) -> Option<Step> {
    let mut rest = text;
    for prefix in ["bnd ", "notrack ", "data16 ", "cs ", "rex.W "] {
        rest = rest.trim_start_matches(prefix);
    }
    let (name, operands) = rest.split_once(' ').unwrap_or((rest, ""));
    let operands = operands.trim_start();
    let is_branch = name.starts_with("call") || name.starts_with('j');
    let register = |r: &str| r.starts_with('%') && !r.contains('(');
    match name {
        "lock" | "syscall" | "sysenter" | "int" => Some(Step::Forbidden),
        _ if name.starts_with("xchg") => operands.contains('(').then_some(Step::Swap),
        _ if is_branch => {
            let Some((_, target)) = operands.split_once('*') else {
                return hex(operands.split(' ').next()?).map(Step::To);
            };
            let is_call = name.starts_with("call");
            if register(target) {
                return Some(Step::Register(target.to_owned(), is_call));
            }
            Some(place(text).map_or(Step::Unknown, Step::Through))
        }
        "mov" => {
            let (from, to) = operands.split(" #").next()?.trim().rsplit_once(',')?;
            if !register(to) {
                None
            } else if register(from) {
                Some(Step::Copy(from.to_owned(), to.to_owned()))
            } else {
                place(text).map(|place| Step::Load(to.to_owned(), place))
            }
        }
        "movslq" if operands.contains(",4)") => Some(Step::Table),
        _ => None,
    }
}

impl Program {
    fn read(path: &Path) -> Self {
        let mut functions = BTreeMap::<u64, Function>::new();
        let mut current = Function::default();
        let mut start = 0;
        let flags = ["--disassemble", "--wide", "--no-show-raw-insn"];
        objdump(&flags, path, |line| {
            if let Some((address, name)) = line.split_once(" <")
                && let Some(name) = name.strip_suffix(">:")
            {
                functions.insert(start, std::mem::take(&mut current));
                start = hex(address).unwrap();
                current.name = name.to_owned();
            } else if let Some((_, text)) = line.split_once('\t')
                && let Some(step) = step(text)
            {
                current.steps.push((step, text.to_owned()));
            }
        });
        functions.insert(start, current);
        let mut table = HashMap::new();
        objdump(&["--dynamic-reloc"], path, |line| {
            let mut words = line.split_whitespace();
            let (Some(at), Some(_), Some(what)) = (words.next(), words.next(), words.next()) else {
                return;
            };
            let target = match what.strip_prefix("*ABS*+") {
                Some(address) => hex(address).map(Target::Local),
                None => what
                    .split('@')
                    .next()
                    .map(|name| Target::Import(name.to_owned())),
            };
            if let (Some(at), Some(target)) = (hex(at), target) {
                table.insert(at, target);
            }
        });
        Self { functions, table }
    }

    /// The functions whose names have all of these words in them.
    fn called(&self, words: &[&str]) -> Vec<u64> {
        let has_all = |f: &&Function| words.iter().all(|w| f.name.contains(w));
        let found = self.functions.iter().filter(|(_, f)| has_all(f));
        let found: Vec<u64> = found.map(|(address, _)| *address).collect();
        assert!(!found.is_empty(), "no function {words:?} in the program");
        found
    }

    /// Follows every call from the roots on.
    fn walk(&self, roots: &[u64]) -> Walk {
        let mut walk = Walk::default();
        let mut open: Vec<u64> = roots.to_vec();
        while let Some(address) = open.pop() {
            let Some((address, function)) = self.functions.range(..=address).next_back() else {
                continue;
            };
            let is_end = NOT_FOLLOWED.iter().any(|n| function.name.contains(n));
            if !is_end && walk.reached.insert(*address) {
                self.follow(function, &mut walk, &mut open);
            }
        }
        walk
    }

    /// All that a function puts into a register from the table of addresses, by way of others too.
    fn loaded(&self, function: &Function, register: &str) -> Vec<&Target> {
        let mut registers = vec![register];
        let mut n_known = 0;
        while n_known < registers.len() {
            n_known = registers.len();
            for (step, _) in &function.steps {
                if let Step::Copy(from, to) = step
                    && registers.contains(&to.as_str())
                    && !registers.contains(&from.as_str())
                {
                    registers.push(from);
                }
            }
        }
        let loads = function.steps.iter().filter_map(|s| match &s.0 {
            Step::Load(to, place) if registers.contains(&to.as_str()) => self.table.get(place),
            _ => None,
        });
        loads.collect()
    }

    fn follow(&self, function: &Function, walk: &mut Walk, open: &mut Vec<u64>) {
        let name = &function.name;
        let has_table = function.steps.iter().any(|s| matches!(s.0, Step::Table));
        for (step, text) in &function.steps {
            let words = || format!("{name}: {text}");
            match step {
                Step::To(address) => open.push(*address),
                Step::Through(place) => match self.table.get(place) {
                    Some(target) => walk.go(target, name, open),
                    None => walk.unknown.push(words()),
                },
                Step::Register(register, is_call) => {
                    let loaded = self.loaded(function, register);
                    for target in &loaded {
                        walk.go(target, name, open);
                    }
                    if loaded.is_empty() && (*is_call || !has_table) {
                        walk.unknown.push(words());
                    }
                }
                Step::Unknown => walk.unknown.push(words()),
                Step::Swap => walk.swaps.push(words()),
                // A reference given back takes no lock.
                Step::Forbidden if text.starts_with("lock dec") => {}
                Step::Forbidden => walk.wrong.push(words()),
                Step::Load(..) | Step::Copy(..) | Step::Table => {}
            }
        }
    }
}

/// What lies on the ways from some functions.
#[derive(Default)]
struct Walk {
    reached: BTreeSet<u64>,
    /// Atomic instructions, system calls, and calls out of the program.
    wrong: Vec<String>,
    /// Calls to what is known at run time only.
    unknown: Vec<String>,
    swaps: Vec<String>,
}

impl Walk {
    fn go(&mut self, target: &Target, from: &str, open: &mut Vec<u64>) {
        match target {
            Target::Local(address) => open.push(*address),
            Target::Import(name) if HARMLESS.split_whitespace().any(|h| h == name) => {}
            Target::Import(name) => self.wrong.push(format!("{from} calls {name}")),
        }
    }
}

fn objdump(flags: &[&str], path: &Path, mut line: impl FnMut(&str)) {
    let mut command = Command::new("objdump");
    command.args(flags).arg(path).stdout(Stdio::piped());
    let mut child = command.spawn().expect("objdump, of binutils");
    for text in BufReader::new(child.stdout.take().unwrap()).lines() {
        line(&text.unwrap());
    }
    assert!(child.wait().unwrap().success());
}

#[test]
fn no_way_through_a_haptic_tick_leads_to_a_lock() {
    let program = Program::read(Path::new(env!("CARGO_BIN_EXE_osteotome")));
    let mut roots = program.called(&["HapticLoop", "4tick"]);
    for method in ["4read", "5write", "6health"] {
        roots.extend(program.called(&["LinkedDevice", "HapticDevice", method]));
    }
    let walk = program.walk(&roots);
    assert!(walk.wrong.is_empty(), "{}", walk.wrong.join("\n"));
    let of_a_device = |u: &&String| u.contains("OperatedDevice");
    let unknown: Vec<_> = walk.unknown.iter().filter(|u| !of_a_device(u)).collect();
    assert!(unknown.is_empty(), "{unknown:#?}");
    // The bone where the line and the step look at it, the hands, a guided hand, and a device's readings and commands.
    assert!(walk.swaps.len() <= 8, "{}", walk.swaps.join("\n"));
    let is_reached = |words| {
        program
            .called(words)
            .iter()
            .any(|f| walk.reached.contains(f))
    };
    assert!(is_reached(&["4step6haptic", "11haptic_step"]));
    assert!(is_reached(&["contact", "5renew"]) && walk.reached.len() > 50);
}

/// Takes a lock that nobody else wants.
#[inline(never)]
fn ways_of_a_lock(lock: &Mutex<u64>) -> u64 {
    *lock.lock().unwrap()
}

#[inline(never)]
fn ways_of_a_counter(counter: &AtomicU64) -> u64 {
    counter.fetch_add(1, Ordering::Relaxed)
}

#[inline(never)]
fn ways_of_a_cell(cell: &OnceLock<u64>) -> u64 {
    *cell.get_or_init(|| 3)
}

#[inline(never)]
fn ways_of_two_threads(a: &mut f64, b: &mut f64) {
    rayon::join(|| *a += 1.0, || *b += 1.0);
}

#[inline(never)]
fn ways_of_a_file(path: &Path) -> bool {
    path.exists()
}

#[inline(never)]
fn ways_of_an_object(object: &dyn Fn(f64) -> f64) -> f64 {
    object(1.0) + 1.0
}

#[inline(never)]
fn ways_of_arithmetic(x: f64) -> f64 {
    x.sin() * x.atan2(2.0) + x
}

/// The test above can fail: what it must find in the haptic loop, it finds in these functions.
#[test]
fn the_walk_finds_locks_threads_files_and_objects() {
    use std::hint::black_box;
    let (mut a, mut b) = (1.0, 2.0);
    black_box(ways_of_a_lock(black_box(&Mutex::new(1))));
    black_box(ways_of_a_counter(black_box(&AtomicU64::new(1))));
    black_box(ways_of_a_cell(black_box(&OnceLock::new())));
    ways_of_two_threads(black_box(&mut a), black_box(&mut b));
    black_box(ways_of_a_file(black_box(Path::new("."))));
    black_box(ways_of_an_object(black_box(&|x| x * a)));
    black_box(ways_of_arithmetic(black_box(b)));

    let program = Program::read(&std::env::current_exe().unwrap());
    let walk = |name: &str| program.walk(&program.called(&[name]));
    let finds = |name, what: &str| {
        let wrong = walk(name).wrong;
        assert!(wrong.iter().any(|w| w.contains(what)), "{name}: {wrong:#?}");
    };
    finds("ways_of_a_lock", "lock cmpxchg");
    finds("ways_of_a_lock", "calls syscall");
    finds("ways_of_a_counter", "lock xadd");
    finds("ways_of_a_cell", "lock cmpxchg");
    finds("ways_of_two_threads", "lock cmpxchg");
    finds("ways_of_a_file", "calls stat");
    assert!(!walk("ways_of_an_object").unknown.is_empty());
    let fine = walk("ways_of_arithmetic");
    assert_eq!(
        [fine.wrong, fine.unknown, fine.swaps],
        [const { Vec::<String>::new() }; 3]
    );
    assert!(!fine.reached.is_empty());
}
