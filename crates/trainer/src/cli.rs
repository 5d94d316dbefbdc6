//! The command line: what the user asks for, and with what exit code it ends.
use crate::bench;
use crate::commands;
use crate::devices;
use crate::fracture;
use crate::picture::{StereoMode, View};
use crate::prepare_command;
use crate::profiles;
use crate::render_command;
use crate::report_command;
use crate::scenario::Override;
use crate::talk;
use crate::window;
use clap::{Args, Parser, Subcommand, ValueEnum};
use osteotome_anatomy::orient::{Axes, Unit};
use osteotome_devices::Binding;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

/// Why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// The input is wrong: exit code 2.
    Input(anyhow::Error),
    /// The work failed: exit code 1.
    Work(anyhow::Error),
}

/// A simulator for learning to split the mandible.
#[derive(Parser)]
#[command(name = "osteotome", version)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Opens the simulator's window (also without a command, where there is a display)
    Train(TrainArgs),
    /// The whole job on the built-in patient, in real time: no display, device or file needed
    Demo(DemoArgs),
    /// One session without a window
    Run(RunArgs),
    /// Makes a patient from a surface, a label volume or tetrahedra
    Prepare(PrepareArgs),
    /// Says what is wrong with a scenario or a patient's folder, and where
    Check(CheckArgs),
    /// Plays a recorded session
    Replay(ReplayArgs),
    /// Who trains here: a history of sessions under a chosen name
    Profiles(ProfilesArgs),
    /// The debrief of recorded sessions, as one page that works offline
    Report(ReportArgs),
    /// A picture or a film of a recorded session
    Render(RenderArgs),
    /// Solves a fracture problem and grows its crack, for research and validation
    Fracture(FractureArgs),
    /// Lists haptic devices, and what is missing for those that are not found
    Devices(DevicesArgs),
    /// The paper's evaluation on this machine: a recorded split timed part by part, beside the paper and other methods
    Bench(BenchArgs),
}

/// Arguments of `train`.
#[derive(Args, Default)]
pub struct TrainArgs {
    /// The scenario (TOML), or a shipped one: bsso-right, bsso-left; without it, what was trained last
    pub scenario: Option<PathBuf>,
    /// Looks back at a recorded session
    #[arg(long, value_name = "SESSION.mcap", conflicts_with_all = ["scenario", "set"])]
    pub from: Option<PathBuf>,
    /// Goes on live from this moment of it \[s\], with the hands that led last; it waits there, paused
    #[arg(long, value_name = "S", requires = "from")]
    pub at: Option<f64>,
    /// Where session folders are kept
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Overrides a key of the scenario by a TOML value (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Override>,
    /// Plays a script of clicks and keys (for tests)
    #[arg(long, value_name = "FILE", hide = true)]
    pub rehearse: Option<PathBuf>,
}

/// Arguments of `demo`.
#[derive(Args)]
pub struct DemoArgs {
    /// Session folder; an earlier session there is replaced
    #[arg(long, value_name = "DIR", default_value = "osteotome-demo")]
    pub out: PathBuf,
    /// Overrides a key of the scenario by a TOML value (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Override>,
}

/// Arguments of `run`.
#[derive(Args)]
pub struct RunArgs {
    /// The scenario (TOML)
    #[arg(required_unless_present = "from", conflicts_with = "from")]
    pub scenario: Option<PathBuf>,
    /// Goes on live from a moment of a recorded session, which is recomputed up to there
    #[arg(
        long,
        value_name = "SESSION.mcap",
        requires = "at",
        conflicts_with = "seed"
    )]
    pub from: Option<PathBuf>,
    /// That moment \[s\]
    #[arg(long, value_name = "S", requires = "from")]
    pub at: Option<f64>,
    /// Who leads the hands: builtin (also the default), or a recorded session
    #[arg(long, value_name = "builtin|FILE.mcap")]
    pub input: Option<PathBuf>,
    /// Against the clock on three threads, or from one thread and repeatable to the last bit
    #[arg(long, value_enum, default_value_t = Mode::Lockstep)]
    pub mode: Mode,
    /// Start of the surgeon's random variations (like --set seed=N)
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Longest simulated time (like --set max_time=S)
    #[arg(long, value_name = "S")]
    pub max_time: Option<f64>,
    /// Session folder; an earlier session there is replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Takes the session into the history of this profile
    #[arg(long, value_name = "NAME")]
    pub profile: Option<String>,
    /// Prints the figures as one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Overrides a key of the scenario by a TOML value (repeatable); with --from only tools' device, workspace and
    /// allow_network
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Override>,
}

/// Arguments of `check`.
#[derive(Args)]
pub struct CheckArgs {
    /// The scenario (TOML), or a patient's folder
    #[arg(value_name = "SCENARIO|PATIENT_DIR")]
    pub scenario: PathBuf,
    /// Overrides a key of the scenario by a TOML value (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Override>,
}

/// Arguments of `prepare`.
#[derive(Args)]
pub struct PrepareArgs {
    /// The bone: STL, PLY, OBJ, NIfTI or NRRD labels, Gmsh .msh or VTK .vtu
    pub input: PathBuf,
    /// Teeth: a surface (STL, PLY or OBJ), each tooth a piece of its own
    #[arg(long, value_name = "FILE")]
    pub teeth: Option<PathBuf>,
    /// The mandibular canal of one side (JSON; mm, LPS; repeatable)
    #[arg(long, value_name = "FILE")]
    pub canal: Vec<PathBuf>,
    /// Named places (JSON; mm, LPS), for osteotomies by technique
    #[arg(long, value_name = "FILE")]
    pub landmarks: Option<PathBuf>,
    /// A surface around the jaw and what it is: maxilla, teeth, skull, soft-tissue, retractor (repeatable)
    #[arg(long, value_name = "ROLE=FILE")]
    pub context: Vec<ContextFile>,
    /// Nodes of the mesh; 5,000, or those of the tetrahedra that are given
    #[arg(long, value_name = "N")]
    pub nodes: Option<usize>,
    /// What the patient is called; the input's file name
    #[arg(long)]
    pub name: Option<String>,
    /// Unit of all surfaces and tetrahedra: mm, cm, m or inch
    #[arg(long, default_value = "mm")]
    pub unit: Unit,
    /// Whither x, y and z point in all surfaces and tetrahedra
    #[arg(long, value_name = "LPS|RAS|...", default_value = "LPS")]
    pub axes: Axes,
    /// Another number for maxilla, mandible, upper-teeth, lower-teeth or canal in a label volume (repeatable)
    #[arg(long, value_name = "NAME=N")]
    pub label: Vec<Label>,
    /// The patient's folder; an earlier patient there is replaced
    #[arg(short, long, value_name = "PATIENT_DIR")]
    pub output: PathBuf,
    /// Prints the report as one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
}

/// A surface around the jaw.
#[derive(Clone, Debug)]
pub struct ContextFile {
    /// What it is.
    pub role: String,
    /// Where it is.
    pub file: PathBuf,
}

impl FromStr for ContextFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((role, file)) if !role.is_empty() && !file.is_empty() => Ok(Self {
                role: role.to_owned(),
                file: file.into(),
            }),
            _ => Err("give what it is and the file, like maxilla=maxilla.stl".to_owned()),
        }
    }
}

/// The number of one label.
#[derive(Clone, Copy, Debug)]
pub struct Label {
    /// maxilla, mandible, upper-teeth, lower-teeth or canal.
    pub name: &'static str,
    /// As in the volume.
    pub number: u8,
}

impl Label {
    const NAMES: [&'static str; 5] = ["maxilla", "mandible", "upper-teeth", "lower-teeth", "canal"];
}

impl FromStr for Label {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            let names = Self::NAMES.join(", ");
            format!("give one of {names} and a number of 1 to 255, like mandible=2")
        };
        let (name, number) = text.split_once('=').ok_or_else(wrong)?;
        let name = Self::NAMES.into_iter().find(|n| *n == name);
        let number = number.parse().ok().filter(|n| *n > 0);
        Ok(Self {
            name: name.ok_or_else(wrong)?,
            number: number.ok_or_else(wrong)?,
        })
    }
}

/// Arguments of `replay`.
#[derive(Args)]
pub struct ReplayArgs {
    /// The recording
    pub session: PathBuf,
    /// Recomputes it in lockstep from the recorded device poses and reports the largest deviation
    #[arg(long)]
    pub verify: bool,
    /// Writes the recomputed session there
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Arguments of `profiles`.
#[derive(Args)]
pub struct ProfilesArgs {
    /// What is to be done
    #[command(subcommand)]
    pub task: ProfilesTask,
}

/// What can be done with profiles.
#[derive(Subcommand)]
pub enum ProfilesTask {
    /// All of them
    List,
    /// Makes one
    Add {
        /// Any name of up to 40 characters
        name: String,
    },
    /// Its sessions with their scores
    Show {
        /// Whose
        name: String,
    },
    /// Its sessions with all figures, for other programs
    Export {
        /// Whose
        name: String,
        /// The file: CSV if it is called so, else JSON
        #[arg(short, value_name = "FILE.json|FILE.csv")]
        output: PathBuf,
    },
    /// Removes it with its history for good; session folders stay
    Delete {
        /// Which
        name: String,
        /// Only this session, by its number
        #[arg(long, value_name = "N")]
        session: Option<i64>,
    },
}

/// Arguments of `report`.
#[derive(Args)]
pub struct ReportArgs {
    /// Recordings in their order; the page is about the last one, all together give the learning curve
    #[arg(required = true, value_name = "SESSION.mcap")]
    pub sessions: Vec<PathBuf>,
    /// A session to compare with, such as an expert's
    #[arg(long, value_name = "SESSION.mcap")]
    pub reference: Option<PathBuf>,
    /// The page
    #[arg(short, value_name = "FILE.html")]
    pub output: PathBuf,
}

/// Arguments of `render`.
#[derive(Args)]
pub struct RenderArgs {
    /// The recording
    pub session: PathBuf,
    /// Time of the picture \[s\]
    #[arg(long, value_name = "S", required_unless_present = "video")]
    pub at: Option<f64>,
    /// Pixels across and down
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub size: [usize; 2],
    /// From where
    #[arg(long, value_enum, value_name = "NAME", default_value_t = View::Close)]
    pub view: View,
    /// Goes around what is looked at, to the right and up \[degrees\]
    #[arg(long, value_name = "RIGHT,UP", value_parser = numbers::<2>, allow_hyphen_values = true)]
    pub turn: Option<[f64; 2]>,
    /// Looks at another point \[mm\]
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true)]
    pub target: Option<[f64; 3]>,
    /// Goes nearer: at 2 everything is twice as large
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = zoom)]
    pub zoom: f64,
    /// Leaves out the chisels and their loads
    #[arg(long)]
    pub no_tools: bool,
    /// Looks through the bone, with the crack in red
    #[arg(long)]
    pub transparent: bool,
    /// A schematic head around: lips, skin, cheek retractor, upper teeth
    #[arg(long)]
    pub head: bool,
    /// Takes fragments apart by so many mm, to look between them
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = apart)]
    pub apart: f64,
    /// For two eyes
    #[arg(long, value_enum, value_name = "MODE")]
    pub stereo: Option<StereoMode>,
    /// From so many places side by side instead of two, 2 to 16
    #[arg(long, value_name = "N", requires = "stereo", value_parser = clap::value_parser!(u8).range(2..=16))]
    pub views: Option<u8>,
    /// Draws on the processor, even where there is a graphics card
    #[arg(long, conflicts_with = "gpu")]
    pub cpu: bool,
    /// Draws through Vulkan, also where its driver is a program on the processor
    #[arg(long)]
    pub gpu: bool,
    /// The picture (PNG)
    #[arg(short, value_name = "FILE.png", required_unless_present = "video")]
    pub output: Option<PathBuf>,
    /// A film of the whole session, through ffmpeg
    #[arg(long, value_name = "FILE.mp4", conflicts_with_all = ["at", "output"])]
    pub video: Option<PathBuf>,
}

/// 0 to 100 mm.
fn apart(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|mm| (0.0..=100.0).contains(mm));
    number.ok_or_else(|| "give a distance of 0 to 100 mm".to_owned())
}

/// .1 to 20.
fn zoom(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|f| (0.1..=20.0).contains(f));
    number.ok_or_else(|| "give a factor of .1 to 20".to_owned())
}

/// So many, each between -10,000 and 10,000.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let number = |t: &str| t.trim().parse().ok().filter(|v: &f64| v.abs() <= 1e4);
    let all: Option<Vec<f64>> = text.split(',').map(number).collect();
    let all = all.and_then(|v| v.try_into().ok());
    all.ok_or_else(|| {
        format!(
            "give {N} numbers with commas between, like {}",
            ["1.5"; N].join(",")
        )
    })
}

/// 16 to 4096 pixels each way.
fn size(text: &str) -> Result<[usize; 2], String> {
    let wrong = || "give pixels across and down, 16 to 4096 each, like 1280x720".to_owned();
    let (w, h) = text.split_once('x').ok_or_else(wrong)?;
    let number = |t: &str| t.parse::<usize>().ok().filter(|n| (16..=4096).contains(n));
    Ok([number(w).ok_or_else(wrong)?, number(h).ok_or_else(wrong)?])
}

/// Arguments of `fracture`.
#[derive(Args)]
pub struct FractureArgs {
    /// The case (TOML)
    pub case: PathBuf,
    /// Folder of results; an earlier result there is replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Prints result.json's object and nothing else
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `devices`.
#[derive(Args)]
pub struct DevicesArgs {
    /// Moves a gentle spring on each device and measures rate, jitter and latency; hold on to the handles
    #[arg(long)]
    pub test: bool,
    /// Looks at this device only, named as in a scenario, e.g. haply:049D or remote:9870 (repeatable)
    #[arg(long, value_name = "DEVICE")]
    pub device: Vec<Binding>,
    /// How long each is tested
    #[arg(long, value_name = "S", default_value_t = 3.0)]
    pub seconds: f64,
    /// Lets a remote device be led from other machines
    #[arg(long)]
    pub allow_network: bool,
    /// Prints one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `bench`.
#[derive(Args)]
pub struct BenchArgs {
    /// Hands to replay: a recorded session; without it, the shipped split at the paper's size
    #[arg(long, value_name = "SESSION.mcap")]
    pub recording: Option<PathBuf>,
    /// Nodes of the simulation mesh, if not those of the recording
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=200_000))]
    pub nodes: Option<u32>,
    /// Points on the bone's surface, likewise
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1000..=1_000_000))]
    pub points: Option<u32>,
    /// Plays no more than so many seconds of it
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub max_time: Option<f64>,
    /// Plays it over and over in real time for so many seconds instead, and says which deadlines were missed
    #[arg(long, value_name = "S", value_parser = seconds, conflicts_with_all = ["json", "figures", "export"])]
    pub soak: Option<f64>,
    /// Prints one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Draws the paper's Figures 5 and 6 of a live session of the built-in surgeon into a folder, as SVG and PNG
    #[arg(long, value_name = "DIR")]
    pub figures: Option<PathBuf>,
    /// Writes equations and chisels' poses for other programs into a folder (see benches/peers)
    #[arg(long, value_name = "DIR")]
    pub export: Option<PathBuf>,
    /// Writes the recording's hands alone to a file, rounded: how the shipped split was made
    #[arg(long, value_name = "FILE.mcap", hide = true, requires = "recording")]
    pub trim: Option<PathBuf>,
}

/// Above 0, to an hour.
fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|s| *s > 0.0 && *s <= 3600.0);
    number.ok_or_else(|| "give a time above 0 and up to 3600 s".to_owned())
}

/// How a session is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// Against the clock.
    Realtime,
    /// From one thread.
    Lockstep,
}

impl Mode {
    /// As written in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Realtime => "realtime",
            Self::Lockstep => "lockstep",
        }
    }
}

/// Runs the program.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let command = match cli.command {
        Some(command) => command,
        None if window::has_display() => Command::Train(TrainArgs::default()),
        None => return help(),
    };
    let result = match command {
        Command::Train(args) => window::train(&args),
        Command::Demo(args) => commands::demo(&args),
        Command::Run(args) => commands::run(&args),
        Command::Prepare(args) => prepare_command::prepare_patient(&args),
        Command::Check(args) => commands::check(&args),
        Command::Replay(args) => commands::replay(&args),
        Command::Profiles(args) => profiles::profiles(&args),
        Command::Report(args) => report_command::report(&args),
        Command::Render(args) => render_command::render(&args),
        Command::Fracture(args) => fracture::fracture(&args),
        Command::Devices(args) => devices::devices(&args),
        Command::Bench(args) => bench::bench(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Work(error)) => {
            talk::complain(&error);
            ExitCode::from(1)
        }
        Err(Failure::Input(error)) => {
            talk::complain(&error);
            ExitCode::from(2)
        }
    }
}

fn help() -> ExitCode {
    use clap::CommandFactory;
    talk::say(Cli::command().render_help().to_string().trim_end());
    ExitCode::SUCCESS
}

/// Help and version go to standard output; a wrong command line is one line like every other wrong input.
fn usage(error: &clap::Error) -> ExitCode {
    let text = error.render().to_string();
    if !error.use_stderr() {
        talk::say(text.trim_end());
        return ExitCode::SUCCESS;
    }
    let line = one_line(&text);
    talk::complain(&anyhow::anyhow!(line));
    ExitCode::from(2)
}

/// Clap's message without usage and the hint at --help.
fn one_line(text: &str) -> String {
    let body = text.split("\nUsage:").next().unwrap_or(text);
    let lines = body
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !l.starts_with("For more"));
    let joined = lines.collect::<Vec<_>>().join(" ");
    format!(
        "{}; see osteotome --help",
        joined.trim_start_matches("error: ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commands_are_well_formed() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn usage_errors_are_one_line() {
        let error =
            Cli::try_parse_from(["osteotome", "run", "a.toml", "--out", "b", "--mode", "x"]);
        let line = one_line(&error.err().unwrap().render().to_string());
        assert!(
            !line.contains('\n') && line.contains("[possible values: realtime, lockstep]"),
            "{line}"
        );
    }
}
