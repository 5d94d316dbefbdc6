//! The window: what it says without a display, and under Xvfb a trainee's session by clicks and keys, and a line planned, looked at
//! by its pixels.
#![allow(clippy::print_stderr)] // a skipped test says so
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

fn osteotome() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_osteotome"));
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    command
}

#[cfg(target_os = "linux")]
#[test]
fn without_a_display_one_line_says_what_to_use_instead() {
    let output = osteotome().arg("train").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    for word in [
        "no display",
        "osteotome demo",
        "osteotome run",
        "osteotome render",
    ] {
        assert!(text.contains(word), "{text}");
    }
    assert!(output.stdout.is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn without_a_display_and_a_command_there_is_help() {
    let output = osteotome().output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("train") && text.contains("demo"), "{text}");
}

#[test]
fn a_scenario_that_is_not_there_is_wrong_input_with_or_without_a_display() {
    let output = osteotome()
        .args(["train", "no/such.toml"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(
        text.contains("no/such.toml") && text.lines().count() == 1,
        "{text}"
    );
}

/// A display that nobody sees.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// `None`, and a line that says so, where Xvfb is not installed.
    fn open() -> Option<Self> {
        let mut command = Command::new("Xvfb");
        command.args([
            "-displayfd",
            "1",
            "-screen",
            "0",
            "1600x1000x24",
            "-nolisten",
            "tcp",
        ]);
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        let Ok(mut server) = command.spawn() else {
            eprintln!("SKIPPED: Xvfb is not installed, so the window was not tested");
            return None;
        };
        let mut number = String::new();
        let mut out = std::io::BufReader::new(server.stdout.take()?);
        std::io::BufRead::read_line(&mut out, &mut number).unwrap();
        let name = format!(":{}", number.trim());
        Some(Self { server, name })
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        // It is gone already if this fails.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A jaw that is quick to make and to draw.
const SMALL_JAW: [&str; 4] = ["--set", "mesh.nodes=300", "--set", "mesh.shell_points=6000"];

/// A folder in which a script is rehearsed.
struct Stage {
    folder: tempfile::TempDir,
    display: Display,
}

impl Stage {
    fn open(settings: &str) -> Option<Self> {
        let display = Display::open()?;
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("config")).unwrap();
        let text = format!("draws_pictures = false\n{settings}");
        std::fs::write(folder.path().join("config/window.toml"), text).unwrap();
        Some(Self { folder, display })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Screenshots go into the folder, sessions into `sessions` in it.
    fn rehearse(&self, script: &str) -> Output {
        self.rehearse_on(&SMALL_JAW, script)
    }

    /// Likewise, with what the window is opened on.
    fn rehearse_on(&self, what: &[&str], script: &str) -> Output {
        let shot = |line: &str| match line.trim().strip_prefix("shot ") {
            Some(name) => format!("shot {}\n", self.path(name).display()),
            None => format!("{line}\n"),
        };
        let script: String = script.lines().map(shot).collect();
        std::fs::write(self.path("script"), script).unwrap();
        let mut command = osteotome();
        command.arg("train").args(what);
        command.arg("--rehearse").arg(self.path("script"));
        command.arg("--out").arg(self.path("sessions"));
        command
            .current_dir(self.folder.path())
            .env("DISPLAY", &self.display.name)
            .env("XDG_RUNTIME_DIR", self.folder.path())
            .env("LIBGL_ALWAYS_SOFTWARE", "1")
            .env("OSTEOTOME_DATA", self.path("data"))
            .env("OSTEOTOME_CONFIG", self.path("config"));
        let output = command.output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{told}");
        output
    }

    fn shot(&self, name: &str) -> Shot {
        Shot::read(&self.path(name))
    }
}

/// A screenshot.
struct Shot {
    width: usize,
    height: usize,
    rgb: Vec<[u8; 3]>,
}

impl Shot {
    fn read(path: &Path) -> Self {
        let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let n = info.color_type.samples();
        Self {
            width: info.width as usize,
            height: info.height as usize,
            rgb: bytes.chunks_exact(n).map(|p| [p[0], p[1], p[2]]).collect(),
        }
    }

    /// Pixels of a part given in pixels from the left, the top, and the right or bottom where negative.
    fn part(&self, x: [i32; 2], y: [i32; 2]) -> Vec<[u8; 3]> {
        let place = |v: i32, n: usize| if v < 0 { n as i32 + v } else { v } as usize;
        let [x, y] = [
            x.map(|v| place(v, self.width)),
            y.map(|v| place(v, self.height)),
        ];
        let row = |y: usize| &self.rgb[y * self.width + x[0]..y * self.width + x[1]];
        (y[0]..y[1]).flat_map(row).copied().collect()
    }

    /// Between the panels beside it, above the plots.
    fn scene(&self) -> Vec<[u8; 3]> {
        self.part([238, -238], [60, -212])
    }

    /// The first plot, and the last.
    fn plots(&self) -> [Vec<[u8; 3]>; 2] {
        let third = (self.width as i32 - 472) / 3;
        let of = |k: i32| self.part([238 + k * third, 236 + (k + 1) * third], [-170, -50]);
        [of(0), of(2)]
    }
}

fn n_different(a: &[[u8; 3]], b: &[[u8; 3]]) -> usize {
    assert_eq!(a.len(), b.len());
    let is_other = |(a, b): &(&[u8; 3], &[u8; 3])| (0..3).any(|k| a[k].abs_diff(b[k]) > 12);
    a.iter().zip(b).filter(is_other).count()
}

/// Of bone: light, and more red than blue.
fn n_bone(part: &[[u8; 3]]) -> usize {
    let is_bone = |p: &&[u8; 3]| p[0] > 110 && p[0] > p[2].saturating_add(20) && p[1] > p[2];
    part.iter().filter(is_bone).count()
}

#[test]
fn a_session_by_clicks_shows_moving_plots_pauses_resets_resizes_and_quits() {
    let Some(stage) = Stage::open("") else { return };
    // A bone that does not break before all is seen.
    let mut sets = SMALL_JAW.to_vec();
    sets.extend(["--set", "material.cortical.toughness=[20.0, 20.0]"]);
    sets.extend(["--set", "material.trabecular.toughness=[20.0, 20.0]"]);
    stage.rehearse_on(
        &sets,
        "wait Ready
         wait Scene
         gone drawing
         rest 4
         shot ready.png
         click Start
         wait Running
         rest 3
         shot early.png
         rest 2
         shot late.png
         key Space
         wait Paused
         rest 1
         shot paused.png
         rest 2
         shot still.png
         drag 0.5 0.4 120 20
         rest 1
         gone drawing
         rest 1
         shot turned.png
         click Go on
         wait Running
         click Reset
         wait Ready
         rest 1
         shot reset.png
         size 1500 900
         rest 1
         shot large.png
         click Start
         wait Running
         rest 1
         quit",
    );
    let shot = |name: &str| stage.shot(&format!("{name}.png"));
    let [ready, early, late] = ["ready", "early", "late"].map(shot);
    assert_eq!([ready.width, ready.height], [1280, 720]);
    let n = ready.scene().len();
    let bone = n_bone(&ready.scene());
    assert!(bone * 10 > n, "bone on {bone} of {n} pixels");
    for k in 0..2 {
        let [a, b] = [&early, &late].map(|s| s.plots()[k].clone());
        let moved = n_different(&a, &b);
        assert!(moved > 20, "plot {k}: {moved} pixels moved");
    }
    let [paused, still] = ["paused", "still"].map(shot);
    for k in 0..2 {
        let moved = n_different(&paused.plots()[k], &still.plots()[k]);
        assert_eq!(moved, 0, "plot {k} moved while time stood still");
    }
    let turned = n_different(&still.scene(), &shot("turned").scene());
    assert!(
        turned * 10 > n,
        "turning the view changed {turned} of {n} pixels"
    );
    let reset = shot("reset");
    let left = n_different(&ready.plots()[0], &reset.plots()[0]);
    assert!(left < 20, "{left} pixels of the first plot are left over");
    let large = shot("large");
    assert_eq!([large.width, large.height], [1500, 900]);
    assert!(n_bone(&large.scene()) * 10 > large.scene().len());
    for session in ["0001-bsso-right-side", "0002-bsso-right-side"] {
        let folder = stage.path("sessions").join(session);
        for file in [
            "session.mcap",
            "metrics.json",
            "crack.ply",
            "bone_final.vtu",
        ] {
            assert!(folder.join(file).is_file(), "{session} lacks {file}");
        }
    }
    let n_entries = std::fs::read_dir(stage.path("sessions")).unwrap().count();
    assert_eq!(n_entries, 2, "nothing half written");
}

#[test]
fn keys_and_mouse_lead_the_chisels_and_what_they_meet_is_felt() {
    let settings = "hands = [\"mouse\", \"mouse\"]\nis_transparent = true\n";
    let Some(stage) = Stage::open(settings) else {
        return;
    };
    stage.rehearse(
        "wait Ready
         click Start
         wait Running
         rest 0.5
         hold W 8
         wait in contact
         shift-drag 0.5 0.4 150 0
         rest 1
         key F1
         wait Hold the left chisel
         key Escape
         gone Hold the left chisel
         click End
         wait Look at the bone
         click Look at the bone
         quit",
    );
    let metrics = stage.path("sessions/0001-bsso-right-side/metrics.json");
    let metrics: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(metrics).unwrap()).unwrap();
    for hand in ["left", "right"] {
        let figure = |name: &str| metrics["hands"][hand][name].as_f64().unwrap();
        assert!(figure("path_length_mm") > 5.0, "{hand} hand");
        assert!(figure("peak_force") > 1.0, "{hand} hand");
    }
    let kept = std::fs::read_to_string(stage.path("config/window.toml")).unwrap();
    assert!(kept.contains("hands = [\"mouse\", \"mouse\"]"), "{kept}");
}

/// Look back at a session, go on from a moment of it, and find both in the trainee's history.
#[test]
fn a_session_is_looked_back_at_gone_on_from_and_remembered() {
    let Some(stage) = Stage::open("profile = \"Ada\"\n") else {
        return;
    };
    let mut add = osteotome();
    add.args(["profiles", "add", "Ada"]);
    let added = add.env("OSTEOTOME_DATA", stage.path("data")).output();
    assert!(added.unwrap().status.success());
    stage.rehearse(
        "wait Ready
         size 1500 980
         wait to the canal
         click Start
         wait Running
         rest 2
         click End
         wait Look at the bone
         click Look back
         wait Re-try from here
         click Play
         rest 1
         click Halt
         rest 3
         shot back.png
         click Re-try from here
         wait Paused
         click Go on
         wait Running
         rest 1
         click End
         wait Look at the bone
         click Look at the bone
         click History
         wait History of Ada
         rest 1
         shot history.png
         click Close
         gone History of Ada
         quit",
    );
    let read = |name: &str| {
        let path = stage.path("sessions").join(name).join("session.mcap");
        osteotome::session::Recording::read(&path).unwrap()
    };
    let [first, second] = ["0001-bsso-right-side", "0002-bsso-right-side"].map(read);
    let origin = second.scenario.retried.unwrap();
    let n = origin.steps as usize;
    assert!(n > 0 && n < first.hands[0].len() && n < second.hands[0].len());
    for i in 0..2 {
        let begins = format!("{:?}", &second.hands[i][..n]);
        assert_eq!(begins, format!("{:?}", &first.hands[i][..n]));
    }
    let mut show = osteotome();
    show.args(["profiles", "show", "Ada"]);
    let shown = show.env("OSTEOTOME_DATA", stage.path("data")).output();
    let shown = String::from_utf8(shown.unwrap().stdout).unwrap();
    for session in ["0001-bsso-right-side", "0002-bsso-right-side"] {
        assert!(shown.contains(session), "{shown}");
    }
}

/// A folder looked through, and a scenario in it gone over to.
#[test]
fn a_scenario_is_found_in_a_list_of_files() {
    let Some(stage) = Stage::open("") else { return };
    let shipped = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scenarios/bsso_left.toml"
    );
    std::fs::create_dir(stage.path("mine")).unwrap();
    std::fs::copy(shipped, stage.path("mine/other.toml")).unwrap();
    stage.rehearse(
        "wait Ready
         wait Scene
         gone drawing
         rest 4
         shot before.png
         click Browse
         wait Open a scenario or a session
         click mine/
         wait other.toml
         rest 1
         shot list.png
         click other.toml
         gone Open a scenario or a session
         wait Ready
         gone drawing
         rest 4
         shot left.png
         quit",
    );
    let [before, list, left] = ["before", "list", "left"].map(|n| stage.shot(&format!("{n}.png")));
    let n = n_different(&before.scene(), &list.scene());
    assert!(n * 4 > before.scene().len(), "the list covers {n} pixels");
    let n = n_different(&before.scene(), &left.scene());
    assert!(n > 20_000, "the other side changed {n} pixels");
    let kept = std::fs::read_to_string(stage.path("config/window.toml")).unwrap();
    assert!(kept.contains("other.toml"), "{kept}");
}

/// Opened on a moment of a recording, the window waits there, goes on when told to, and ends with the recording's time.
#[test]
fn a_recording_named_on_the_command_line_is_gone_on_from() {
    let Some(stage) = Stage::open("") else { return };
    let mut run = osteotome();
    let scenario = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scenarios/bsso_right.toml"
    );
    run.args(["run", scenario, "--out", "first", "--max-time", "0.5"]);
    run.args(SMALL_JAW);
    let ran = run.current_dir(stage.folder.path()).output().unwrap();
    assert!(ran.status.success());
    let first = stage.path("first/session.mcap");
    let first = first.to_str().unwrap();
    stage.rehearse_on(&["--from", first], "wait Re-try from here\nquit");
    stage.rehearse_on(
        &["--from", first, "--at", "0.3"],
        "wait Paused
         click Go on
         wait Look at the bone
         quit",
    );
    let again = std::fs::read_dir(stage.path("sessions")).unwrap();
    let again = again.map(|f| f.unwrap().path().join("session.mcap"));
    let [again]: [PathBuf; 1] = again.collect::<Vec<_>>().try_into().unwrap();
    let again = osteotome::session::Recording::read(&again).unwrap();
    assert_eq!(again.scenario.retried.unwrap().steps, 300);
    assert_eq!(again.hands[0].len(), 500, "it went on");

    let mut late = osteotome();
    late.args(["train", "--from", first, "--at", "9"]);
    let late = late.output().unwrap();
    assert_eq!(late.status.code(), Some(2));
    let told = String::from_utf8_lossy(&late.stderr);
    assert!(
        told.contains("session.mcap") && told.contains("no moment at 9"),
        "{told}"
    );
}

/// The planner: techniques, the other side, a point dragged, and a scenario saved that the window goes over to.
#[test]
fn a_line_is_planned_dragged_and_saved_as_a_scenario() {
    let Some(stage) = Stage::open("is_transparent = true\n") else {
        return;
    };
    stage.rehearse(
        "wait Ready
         wait Scene
         gone drawing
         rest 4
         shot before.png
         click Plan the line
         wait The line is sound
         rest 2
         shot plan.png
         click Obwegeser
         wait Obwegeser's line
         rest 1
         shot obwegeser.png
         click Mirror to the other side
         wait Mirrored
         click Hunsuck
         wait Hunsuck's line
         rest 1
         shot left.png
         click Save scenario
         gone Osteotomy planner
         wait Saved
         quit",
    );
    let [before, plan, obwegeser, left] =
        ["before", "plan", "obwegeser", "left"].map(|n| stage.shot(&format!("{n}.png")));
    for (what, a, b) in [
        ("the planner", &before, &plan),
        ("another technique", &plan, &obwegeser),
        ("the other side", &obwegeser, &left),
    ] {
        let n = n_different(&a.scene(), &b.scene());
        assert!(n > 300, "{what} changed {n} pixels");
    }
    let text = std::fs::read_to_string(stage.path("planned.toml")).unwrap();
    let saved: toml::Table = text.parse().unwrap();
    assert_eq!(saved["osteotomy"]["side"].as_str(), Some("left"));
    let line = std::fs::read_to_string(stage.path("planned.osteotomy.json")).unwrap();
    let line: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!(line["side"], "left");
    assert!(line["points"].as_array().unwrap().len() > 30);
}
