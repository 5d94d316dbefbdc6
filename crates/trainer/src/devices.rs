//! `osteotome devices`: what is there, what is missing for what is not, and how well devices keep up.
use crate::cli::{DevicesArgs, Failure};
use crate::talk;
use anyhow::{Result, anyhow};
use osteotome_devices::{
    Binding, Driver, Exercise, HandParameters, HapticDevice, LinkedDevice, OpenError, Pose,
    SimulatedHand, Specification, exercise,
};
use serde::Serialize;
use std::time::{Duration, Instant};

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    schema: &'static str,
    units: &'static str,
    devices: Vec<Found>,
    missing: Vec<Missing>,
}

#[derive(Serialize)]
struct Found {
    /// As a scenario names it.
    device: String,
    model: String,
    dofs_in: u8,
    dofs_out: u8,
    max_force: f64,
    max_torque: f64,
    nominal_stiffness: Option<f64>,
    workspace: Option<[f64; 3]>,
    fault: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    test: Option<Test>,
}

#[derive(Serialize)]
struct Test {
    rate_hz: f64,
    jitter_us: f64,
    /// On the haptic thread, from taking a reading to having given the wrench: median, 99 %.
    read_to_write_us: [u32; 2],
    /// From the driver's reading of the device to its handing on of the wrench that answers: median, 99 %.
    device_to_device_us: Option<[u32; 2]>,
    fault: Option<String>,
}

#[derive(Serialize)]
struct Missing {
    driver: &'static str,
    reason: String,
}

/// `devices`.
pub fn devices(args: &DevicesArgs) -> Result<(), Failure> {
    if !(args.seconds > 0.0 && args.seconds <= 600.0) {
        let text = format!(
            "--seconds {}: give a number above 0 and up to 600",
            args.seconds
        );
        return Err(Failure::Input(anyhow!(text)));
    }
    let report = if args.device.is_empty() {
        all(args)?
    } else {
        named(args)?
    };
    if args.json {
        let text = serde_json::to_string_pretty(&report).map_err(|e| Failure::Work(e.into()))?;
        talk::say(&text);
    } else {
        report.devices.iter().for_each(|d| talk::say(&line(d)));
        let missing = report.missing.iter();
        missing.for_each(|m| talk::say(&format!("not there: {}: {}", m.driver, m.reason)));
    }
    Ok(())
}

fn report(devices: Vec<Found>, missing: Vec<Missing>) -> Report {
    Report {
        schema: "osteotome.devices/1",
        units: "mm, N, N mm, s",
        devices,
        missing,
    }
}

/// What every driver finds.
fn all(args: &DevicesArgs) -> Result<Report, Failure> {
    let mut found = vec![simulated(args)?];
    let mut missing = Vec::new();
    for driver in Driver::ALL {
        match driver.connect() {
            Ok(devices) => found.extend(devices.into_iter().map(|d| {
                let serial = d.specification().serial.clone();
                let serial = (!serial.is_empty()).then_some(serial);
                look_at(&Binding::Found { driver, serial }, d, args)
            })),
            Err(error) => missing.push(missed(driver, &error)),
        }
    }
    Ok(report(found, missing))
}

fn missed(driver: Driver, error: &OpenError) -> Missing {
    let driver = driver.name();
    let text = error.to_string();
    let reason = text.strip_prefix(&format!("{driver}: ")).unwrap_or(&text);
    Missing {
        driver,
        reason: reason.to_owned(),
    }
}

/// Only what was asked for; a device that is not there is an error.
fn named(args: &DevicesArgs) -> Result<Report, Failure> {
    let opened = osteotome_devices::open(&args.device, args.allow_network);
    let opened = opened.map_err(|e| Failure::Input(e.into()))?;
    let looked = args
        .device
        .iter()
        .zip(opened)
        .map(|(binding, device)| match device {
            Some(device) => Ok(look_at(binding, device, args)),
            None => simulated(args),
        });
    Ok(report(looked.collect::<Result<_, _>>()?, Vec::new()))
}

fn simulated(args: &DevicesArgs) -> Result<Found, Failure> {
    let hand = SimulatedHand::new(HandParameters::default(), Pose::identity(), 1e-3);
    let mut hand = hand.map_err(|e| Failure::Work(e.into()))?;
    let mut found = described(&Binding::Simulated, hand.specification());
    if args.test {
        let e = exercise(&mut hand, Duration::from_secs_f64(args.seconds));
        found.test = Some(test(&e, None));
    }
    Ok(found)
}

/// A remote hand's client may take its time.
const PATIENCE: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(30)];

fn look_at(binding: &Binding, mut device: LinkedDevice, args: &DevicesArgs) -> Found {
    let mut found = described(binding, device.specification());
    let is_remote = matches!(binding, Binding::Remote(_));
    let since = Instant::now();
    while since.elapsed() < PATIENCE[usize::from(is_remote && args.test)] {
        device.read();
        if device.health().fault.is_none() {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    found.fault = device.health().fault.map(|f| f.to_string());
    if args.test {
        let e = exercise(&mut device, Duration::from_secs_f64(args.seconds));
        found.test = Some(test(&e, Some(&device)));
    }
    found
}

fn described(binding: &Binding, s: &Specification) -> Found {
    Found {
        device: binding.to_string(),
        model: s.model.clone(),
        dofs_in: s.dofs_in,
        dofs_out: s.dofs_out,
        max_force: s.max_force,
        max_torque: s.max_torque,
        nominal_stiffness: s.nominal_stiffness,
        workspace: s.workspace,
        fault: None,
        test: None,
    }
}

fn test(e: &Exercise, device: Option<&LinkedDevice>) -> Test {
    let latency = device.map(LinkedDevice::latency);
    let both = |l: &osteotome_devices::Latency| Some([l.quantile_us(0.5)?, l.quantile_us(0.99)?]);
    Test {
        rate_hz: e.rate_hz,
        jitter_us: e.jitter_us,
        read_to_write_us: e.read_to_write_us,
        device_to_device_us: latency.and_then(both),
        fault: e.fault.map(|f| f.to_string()),
    }
}

fn line(d: &Found) -> String {
    let output = match (d.max_force > 0.0, d.max_torque > 0.0) {
        (true, true) => format!("{:.1} N, {:.0} N mm", d.max_force, d.max_torque),
        (true, false) => format!("{:.1} N, no torque", d.max_force),
        _ => "no force".to_owned(),
    };
    let mut text = format!(
        "{}  {}, {}/{} dof, {output}",
        d.device, d.model, d.dofs_in, d.dofs_out
    );
    if let Some(fault) = &d.fault {
        text += &format!("\n    {fault}");
    }
    if let Some(t) = &d.test {
        let [p50, p99] = t.read_to_write_us;
        text += &format!(
            "\n    {:.0} readings/s, jitter {:.0} us, read to write {p50} us ({p99} us at 99 %)",
            t.rate_hz, t.jitter_us
        );
        if let Some([p50, p99]) = t.device_to_device_us {
            text += &format!(", device to device {p50} us ({p99} us at 99 %)");
        }
        if let Some(fault) = &t.fault {
            text += &format!("\n    while tested: {fault}");
        }
    }
    text
}
