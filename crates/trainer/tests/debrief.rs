//! What a session leaves, as others meet it: the page in a browser, the recording in the stock Python reader, a killed and a full disk.
#![cfg(unix)]
#![expect(clippy::print_stdout, reason = "a test that is skipped says so")]
use osteotome::session::Recording;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_osteotome");

fn osteotome(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder).args(args);
    command.output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn scenario() -> String {
    concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../scenarios/bsso_right.toml"
    )
    .to_owned()
}

/// A whole split, in lockstep.
fn split(folder: &Path) {
    let output = osteotome(folder, &["run", &scenario(), "--out", "out"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

fn first_there(names: &[&str]) -> Option<String> {
    let starts = |name: &&&str| {
        let mut command = Command::new(name);
        command
            .arg("--version")
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command.status().is_ok_and(|s| s.success())
    };
    names.iter().find(starts).map(|n| (*n).to_owned())
}

/// Catches whatever goes wrong, before anything else of the page runs.
/// A browser without a window draws no frames when it only dumps the page, so frames come from a timer.
const WATCH: &str = "<script>window.wrong = [];
    window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16);
    addEventListener('error', (e) => wrong.push('error: ' + e.message));
    addEventListener('unhandledrejection', (e) => wrong.push('rejected: ' + e.reason));
    addEventListener('securitypolicyviolation', (e) => wrong.push('asked for ' + e.blockedURI));
    for (const k of ['error', 'warn']) console[k] = (...a) => wrong.push(k + ': ' + a.join(' '));</script>";

/// Moves what can be moved, and writes what was seen into the page's title.
const TRY: &str = "<script>(async () => {
    const view = document.getElementById('view'), time = document.getElementById('time'), seen = {};
    const drawn = () => new Promise((f) => requestAnimationFrame(() => requestAnimationFrame(() => {
        let h = 7; for (const c of view.toDataURL()) h = (31 * h + c.charCodeAt(0)) | 0; f(h); })));
    const mark = () => [...document.querySelectorAll('.now')].map((l) => +l.getAttribute('x1'));
    const to = async (t) => { time.value = t; time.dispatchEvent(new Event('input')); return [await drawn(), mark()]; };
    seen.start = await to(0); seen.middle = await to(time.max / 2); seen.end = await to(time.max); seen.again = await to(time.max / 2);
    document.getElementById('transparent').click(); seen.through = await drawn();
    view.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft' })); seen.turned = await drawn();
    view.dispatchEvent(new KeyboardEvent('keydown', { key: '+' })); seen.nearer = await drawn();
    seen.asked = performance.getEntriesByType('resource').map((r) => r.name).filter((n) => !n.startsWith('data:'));
    seen.unnamed = [...document.querySelectorAll('img:not([alt]), canvas:not([aria-label])')].length;
    seen.wide = document.documentElement.scrollWidth > innerWidth;
    seen.wrong = wrong;
    document.title = 'SEEN' + JSON.stringify(seen) + 'NEES';
})();</script>";

#[test]
fn the_page_works_in_a_browser_and_asks_nothing_of_the_network() {
    let Some(browser) = first_there(&["chromium", "chromium-browser", "google-chrome"]) else {
        println!("SKIPPED: no chromium here; install it to test the page");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    split(folder.path());
    let html = std::fs::read_to_string(folder.path().join("out/report.html")).expect("the page");
    assert!(html.len() < 10 << 20, "{} bytes", html.len());
    assert!(
        !html.contains("http://")
            || html.matches("http://").count() == html.matches("http://www.w3.org/").count()
    );
    assert!(!html.contains("https://"));
    let watched = html.replacen("<style>", &format!("{WATCH}<style>"), 1);
    let tried = watched.replacen("</body>", &format!("{TRY}</body>"), 1);
    let page = folder.path().join("page.html");
    std::fs::write(&page, tried).expect("writable");
    for width in ["1280,900", "500,900"] {
        let profile = folder.path().join("profile");
        let output = Command::new(&browser)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--use-gl=angle",
                "--use-angle=swiftshader",
            ])
            .args([
                "--enable-unsafe-swiftshader",
                "--virtual-time-budget=20000",
                "--dump-dom",
            ])
            .arg(format!("--window-size={width}"))
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("file://{}", page.display()))
            .output()
            .expect("the browser starts");
        let dom = text(&output.stdout);
        let found = dom
            .split("<title>SEEN")
            .nth(1)
            .and_then(|d| d.split("NEES").next());
        let found =
            found.unwrap_or_else(|| panic!("the page did not run: {}", text(&output.stderr)));
        let found = found
            .replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&amp;", "&");
        let seen: serde_json::Value = serde_json::from_str(&found).expect("what was seen");
        assert_eq!(seen["wrong"], serde_json::json!([]), "{seen}");
        assert_eq!(seen["asked"], serde_json::json!([]), "{seen}");
        assert_eq!(
            (&seen["unnamed"], &seen["wide"]),
            (&0.into(), &false.into()),
            "{seen}"
        );
        let pictures = ["start", "middle", "end"].map(|k| seen[k][0].as_i64().expect("a picture"));
        assert!(
            pictures[0] != pictures[1] && pictures[1] != pictures[2],
            "{seen}"
        );
        assert_eq!(
            seen["again"], seen["middle"],
            "the same time looks the same"
        );
        for plot in 0..3 {
            let [a, b, c] =
                ["start", "middle", "end"].map(|k| seen[k][1][plot].as_f64().expect("a mark"));
            assert!(a < b && b < c, "plot {plot}: {seen}");
        }
        let later = ["through", "turned", "nearer"].map(|k| seen[k].as_i64().expect("a picture"));
        assert!(
            later[0] != pictures[1] && later[1] != later[0] && later[2] != later[1],
            "{seen}"
        );
    }
}

#[test]
fn the_stock_python_reader_reads_the_recording() {
    let has_mcap = |python: &String| {
        let mut command = Command::new(python);
        command
            .args(["-c", "import mcap.reader"])
            .stderr(Stdio::null());
        command.status().is_ok_and(|s| s.success())
    };
    let Some(python) = first_there(&["python3"]).filter(has_mcap) else {
        println!("SKIPPED: no python3 with the package mcap here");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let output = osteotome(
        folder.path(),
        &["run", &scenario(), "--max-time", "0.5", "--out", "out"],
    );
    assert!(output.status.success(), "{}", text(&output.stderr));
    let script = "import json, sys\nfrom mcap.reader import make_reader\nn = {}\nwith open(sys.argv[1], 'rb') as f:\n    for s, c, m in make_reader(f).iter_messages():\n        assert s.encoding == 'jsonschema' and json.loads(s.data)['type'] == 'object'\n        json.loads(m.data)\n        n[c.topic] = n.get(c.topic, 0) + 1\nprint(json.dumps(n))";
    let mut command = Command::new(python);
    command
        .current_dir(folder.path())
        .args(["-c", script, "out/session.mcap"]);
    let output = command.output().expect("python starts");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let counts: serde_json::Value = serde_json::from_slice(&output.stdout).expect("counts");
    assert_eq!(
        (&counts["/haptic/left"], &counts["/haptic/right"]),
        (&500.into(), &500.into())
    );
    assert_eq!(
        (&counts["/main"], &counts["/scenario"]),
        (&25.into(), &1.into())
    );
}

#[test]
fn a_killed_session_is_reported_replayed_and_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut child = Command::new(PROGRAM)
        .current_dir(folder.path())
        .args(["run", &scenario(), "--mode", "realtime", "--out", "out"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let recording = folder.path().join("out.partial/session.mcap");
    let patience = Instant::now() + Duration::from_secs(300);
    let is_under_way = || Recording::read(&recording).is_ok_and(|r| r.hands[0].len() > 2000);
    while !is_under_way() {
        assert!(Instant::now() < patience, "no recording appears");
        assert!(
            child.try_wait().expect("a child").is_none(),
            "it ended by itself"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().expect("SIGKILL");
    child.wait().expect("it is gone");
    let left = Recording::read(&recording).expect("readable");
    assert!(left.is_cut_short && !left.bone.is_empty());
    let path = "out.partial/session.mcap";
    for args in [
        &["report", path, "-o", "page.html"][..],
        &["replay", path],
        &[
            "render",
            path,
            "--at",
            "1.5",
            "--size",
            "64x48",
            "-o",
            "picture.png",
        ],
    ] {
        let output = osteotome(folder.path(), args);
        assert!(
            output.status.success(),
            "{args:?}: {}",
            text(&output.stderr)
        );
    }
    let page = std::fs::read_to_string(folder.path().join("page.html")).expect("the page");
    assert!(page.contains("This recording breaks off"));
    // The next session of that name sets it aside.
    let again = osteotome(
        folder.path(),
        &["run", &scenario(), "--max-time", "0.1", "--out", "out"],
    );
    assert!(again.status.success(), "{}", text(&again.stderr));
    assert!(folder.path().join("out.interrupted/session.mcap").is_file());
    assert!(folder.path().join("out/report.html").is_file());
}

/// A limit on file sizes fails writes as a full disk does.
#[test]
fn a_full_disk_ends_the_session_with_what_was_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = Command::new("sh")
        .current_dir(folder.path())
        .args([
            "-c",
            "trap '' XFSZ; ulimit -f 1000; exec \"$@\"",
            "sh",
            PROGRAM,
        ])
        .args(["run", &scenario(), "--out", "out"])
        .output()
        .expect("sh starts");
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    assert!(
        error.contains("out.interrupted") && error.contains("File too large"),
        "{error}"
    );
    assert!(!folder.path().join("out").exists() && !folder.path().join("out.partial").exists());
    let kept = Recording::read(&folder.path().join("out.interrupted/session.mcap"));
    assert!(!kept.expect("readable").hands[0].is_empty());
}

#[test]
fn a_place_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("file"), "1").expect("writable");
    let args = ["run", &scenario(), "--max-time", "0.1", "--out", "file/out"];
    let output = osteotome(folder.path(), &args);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(
        error.contains("file/out") && error.lines().count() == 1,
        "{error}"
    );
    for args in [
        &["report", "none.mcap", "-o", "page.html"][..],
        &["report", "file", "-o", "page.html"],
        &["report", "file", "-o", "nowhere/page.html"],
    ] {
        let output = osteotome(folder.path(), args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert_eq!(text(&output.stderr).lines().count(), 1, "{args:?}");
    }
    assert!(!folder.path().join("page.html").exists());
}

#[test]
fn a_profile_keeps_a_history_until_it_is_deleted() {
    let folder = tempfile::tempdir().expect("a folder");
    let profiles = |args: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.current_dir(folder.path()).args(args);
        command
            .env("OSTEOTOME_DATA", "data")
            .output()
            .expect("the program starts")
    };
    let good = |args: &[&str]| {
        let output = profiles(args);
        assert!(
            output.status.success(),
            "{args:?}: {}",
            text(&output.stderr)
        );
        text(&output.stdout)
    };
    let run = [
        "run",
        &scenario(),
        "--max-time",
        "0.1",
        "--out",
        "out",
        "--profile",
        "Ada",
    ];
    let nobody = profiles(&run);
    assert_eq!(nobody.status.code(), Some(2));
    assert!(
        text(&nobody.stderr).contains("no profile Ada"),
        "{}",
        text(&nobody.stderr)
    );
    assert!(
        !folder.path().join("out").exists(),
        "refused before it began"
    );
    good(&["profiles", "add", "Ada"]);
    good(&run);
    let shown = good(&["profiles", "show", "ada"]);
    assert!(shown.contains("out") && shown.contains('%'), "{shown}");
    for file in ["ada.csv", "ada.json"] {
        good(&["profiles", "export", "Ada", "-o", file]);
    }
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("readable");
    assert_eq!(read("ada.csv").lines().count(), 2);
    let json: serde_json::Value = serde_json::from_str(&read("ada.json")).expect("JSON");
    assert_eq!(json["sessions"][0]["folder"], "out");
    // A database that is gone wrong costs the history, not the session.
    std::fs::write(folder.path().join("data/profiles.sqlite"), [7; 5000]).expect("writable");
    let damaged = profiles(&["profiles", "list"]);
    assert_eq!(damaged.status.code(), Some(2));
    let told = text(&damaged.stderr);
    assert!(
        told.contains("damaged") && told.lines().count() == 1,
        "{told}"
    );
    std::fs::remove_file(folder.path().join("data/profiles.sqlite")).expect("there");
    good(&["profiles", "add", "Ada"]);
    good(&["profiles", "delete", "Ada"]);
    assert!(good(&["profiles", "list"]).contains("no profile yet"));
}
