//! Which device: named in a scenario, looked for at run time.
use crate::{HapticDevice, LinkedDevice, OpenError, force_dimension, haply, openhaptics, remote};
use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::str::FromStr;

/// A driver that finds devices by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// 3D Systems' Phantom and Touch.
    OpenHaptics,
    /// Force Dimension's omega, delta, sigma, lambda.
    ForceDimension,
    /// Haply's Inverse3.
    Haply,
    /// 3Dconnexion's SpaceMouse.
    Spacenav,
    /// Any gamepad.
    Gamepad,
}

impl Driver {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::OpenHaptics,
        Self::ForceDimension,
        Self::Haply,
        Self::Spacenav,
        Self::Gamepad,
    ];

    /// As it is written in scenarios.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenHaptics => "openhaptics",
            Self::ForceDimension => "forcedimension",
            Self::Haply => "haply",
            Self::Spacenav => "spacenav",
            Self::Gamepad => "gamepad",
        }
    }

    /// Opens all of its devices.
    ///
    /// # Errors
    /// What is missing, and where it was sought.
    pub fn connect(self) -> Result<Vec<LinkedDevice>, OpenError> {
        match self {
            Self::OpenHaptics => openhaptics::connect(),
            Self::ForceDimension => force_dimension::connect(),
            Self::Haply => haply::connect(),
            #[cfg(unix)]
            Self::Spacenav => crate::spacenav::connect().map(|d| vec![d]),
            #[cfg(not(unix))]
            Self::Spacenav => Err(OpenError::Refused {
                driver: self.name(),
                message: "spacenavd is not available on this system".to_owned(),
            }),
            Self::Gamepad => crate::gamepad::connect(),
        }
    }
}

/// Which device leads a tool: `simulated`, `DRIVER`, `DRIVER:SERIAL`, `remote:PORT` or `remote:ADDRESS:PORT`.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Binding {
    /// A simulated hand.
    #[default]
    Simulated,
    /// A device that its driver finds.
    Found {
        /// Which driver.
        driver: Driver,
        /// Which of its devices; may be left out where there is only one.
        serial: Option<String>,
    },
    /// Another program, over UDP.
    Remote(SocketAddr),
}

/// Not the name of a device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} names no device; give simulated, openhaptics[:SERIAL], forcedimension[:SERIAL], haply[:SERIAL], spacenav, gamepad[:NUMBER], remote:PORT or remote:ADDRESS:PORT"
)]
pub struct BadBinding(String);

impl FromStr for Binding {
    type Err = BadBinding;

    fn from_str(text: &str) -> Result<Self, BadBinding> {
        let bad = || BadBinding(text.to_owned());
        let (name, rest) = match text.split_once(':') {
            Some((name, rest)) if !rest.is_empty() => (name, Some(rest)),
            Some(_) => return Err(bad()),
            None => (text, None),
        };
        match (name, rest) {
            ("simulated", None) => Ok(Self::Simulated),
            ("remote", Some(rest)) => {
                let port = rest
                    .parse()
                    .map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
                port.or_else(|_| rest.parse())
                    .map(Self::Remote)
                    .map_err(|_| bad())
            }
            _ => {
                let driver = Driver::ALL
                    .into_iter()
                    .find(|d| d.name() == name)
                    .ok_or_else(bad)?;
                Ok(Self::Found {
                    driver,
                    serial: rest.map(ToOwned::to_owned),
                })
            }
        }
    }
}

impl fmt::Display for Binding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated => f.write_str("simulated"),
            Self::Found {
                driver,
                serial: None,
            } => f.write_str(driver.name()),
            Self::Found {
                driver,
                serial: Some(serial),
            } => write!(f, "{}:{serial}", driver.name()),
            Self::Remote(address) => write!(f, "remote:{address}"),
        }
    }
}

impl TryFrom<String> for Binding {
    type Error = BadBinding;
    fn try_from(text: String) -> Result<Self, BadBinding> {
        text.parse()
    }
}

impl From<Binding> for String {
    fn from(binding: Binding) -> Self {
        binding.to_string()
    }
}

/// Opens what is bound, each driver once; `None` for simulated hands. Devices that nothing is bound to are let go.
///
/// # Errors
/// The first binding that cannot be met.
pub fn open(
    bindings: &[Binding],
    allow_network: bool,
) -> Result<Vec<Option<LinkedDevice>>, OpenError> {
    let mut opened: Vec<_> = bindings.iter().map(|_| None).collect();
    for driver in Driver::ALL {
        let is_wanted = |b: &Binding| matches!(b, Binding::Found { driver: d, .. } if *d == driver);
        if !bindings.iter().any(is_wanted) {
            continue;
        }
        let mut present = driver.connect()?;
        for (binding, slot) in bindings.iter().zip(&mut opened) {
            if let Binding::Found { driver: d, serial } = binding
                && *d == driver
            {
                *slot = Some(choose(driver, serial.as_deref(), &mut present)?);
            }
        }
    }
    for (binding, slot) in bindings.iter().zip(&mut opened) {
        if let Binding::Remote(address) = binding {
            *slot = Some(remote::listen(*address, allow_network)?.device);
        }
    }
    Ok(opened)
}

/// By its serial number; without one only if there is no choice.
fn choose(
    driver: Driver,
    serial: Option<&str>,
    present: &mut Vec<LinkedDevice>,
) -> Result<LinkedDevice, OpenError> {
    let position = match serial {
        Some(serial) => present
            .iter()
            .position(|d| d.specification().serial == serial),
        None => (present.len() == 1).then_some(0),
    };
    if let Some(position) = position {
        return Ok(present.swap_remove(position));
    }
    let problem = match serial {
        Some(serial) => format!("no device with the serial number {serial} is left"),
        None if present.is_empty() => "no device is left".to_owned(),
        None => "there are several devices; say which by DRIVER:SERIAL".to_owned(),
    };
    let names = present.iter().map(|d| {
        let s = d.specification();
        format!("{}:{} ({})", driver.name(), s.serial, s.model)
    });
    let names = names.collect::<Vec<_>>().join(", ");
    Err(OpenError::Choice {
        driver: driver.name(),
        problem,
        present: if names.is_empty() {
            "none".to_owned()
        } else {
            names
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::link;
    use crate::{OMNI, Specification};
    use std::sync::Arc;
    use std::time::Duration;

    #[test]
    fn names_are_read_and_written() {
        for text in [
            "simulated",
            "openhaptics",
            "openhaptics:SN:1",
            "forcedimension:7001",
            "haply:049D",
            "spacenav",
            "gamepad:0",
            "remote:10.0.0.1:9870",
            "remote:[::1]:9870",
        ] {
            assert_eq!(text.parse::<Binding>().unwrap().to_string(), text);
        }
        let remote: Binding = "remote:9870".parse().unwrap();
        assert_eq!(remote.to_string(), "remote:127.0.0.1:9870");
        for text in [
            "",
            "phantom",
            "openhaptics:",
            "simulated:1",
            "remote",
            "remote:99999",
        ] {
            let message = text.parse::<Binding>().unwrap_err().to_string();
            assert!(message.contains(&format!("{text:?}")), "{message}");
        }
    }

    fn present(serials: &[&str]) -> Vec<LinkedDevice> {
        let device = |s: &&str| {
            let specification = Specification::of(&OMNI, *s);
            link(specification, Duration::ZERO, Arc::new(())).0
        };
        serials.iter().map(device).collect()
    }

    #[test]
    fn a_device_is_chosen_by_serial_number_never_by_order() {
        let mut two = present(&["A", "B"]);
        let refusal = choose(Driver::Haply, None, &mut two)
            .err()
            .unwrap()
            .to_string();
        assert!(
            refusal.contains("haply:A") && refusal.contains("haply:B"),
            "{refusal}"
        );
        assert_eq!(
            choose(Driver::Haply, Some("B"), &mut two)
                .unwrap()
                .specification()
                .serial,
            "B"
        );
        assert!(choose(Driver::Haply, Some("B"), &mut two).is_err(), "taken");
        assert_eq!(
            choose(Driver::Haply, None, &mut two)
                .unwrap()
                .specification()
                .serial,
            "A"
        );
        assert!(choose(Driver::Haply, None, &mut two).is_err());
    }
}
