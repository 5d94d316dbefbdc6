//! Vendors' libraries, looked for at run time.
use crate::OpenError;
use libloading::Library;

/// Where a library is looked for.
pub(crate) struct Sought {
    /// What messages call it.
    pub what: &'static str,
    /// An environment variable with its path, which goes before all else.
    pub variable: &'static str,
    /// Names and paths tried in turn.
    pub names: &'static [&'static str],
    /// What the user can do.
    pub mend: &'static str,
}

impl Sought {
    /// Loads it; it stays loaded to the end of the program, since it may have started threads of its own.
    #[allow(unsafe_code)]
    pub(crate) fn load(&self) -> Result<&'static Library, OpenError> {
        let given = std::env::var(self.variable).ok();
        let candidates: Vec<&str> = match &given {
            Some(path) => vec![path.as_str()],
            None => self.names.to_vec(),
        };
        let mut sought = Vec::new();
        for name in candidates {
            // SAFETY: loading runs the library's initialisers. The names are those of the vendors' drivers, or a path that
            // the user has named for this purpose; either is trusted like any other shared library of the system.
            match unsafe { Library::new(name) } {
                Ok(library) => return Ok(Box::leak(Box::new(library))),
                Err(error) => sought.push(reason(name, &error)),
            }
        }
        Err(OpenError::Missing {
            what: self.what,
            sought: sought.join("; "),
            mend: format!("{}, or set {} to its path", self.mend, self.variable),
        })
    }
}

/// The loader's reason in one line, without its repetition of the name.
fn reason(name: &str, error: &libloading::Error) -> String {
    let text =
        std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string);
    let text = text.replace('\n', " ");
    let short = text.strip_prefix(name).unwrap_or(&text);
    let short = short.trim_start_matches(':').trim();
    if short.contains("No such file") || short.contains("not found") {
        name.to_owned()
    } else {
        format!("{name} ({short})")
    }
}

/// A struct of a library's functions and how to load it. The caller answers for the signatures.
macro_rules! functions {
    ($name:ident { $($field:ident = $symbol:literal: fn($($argument:ty),*) $(-> $result:ty)?;)* }) => {
        struct $name {
            $($field: unsafe extern "system" fn($($argument),*) $(-> $result)?,)*
        }

        impl $name {
            fn load(library: &'static libloading::Library) -> Result<Self, $crate::OpenError> {
                Ok(Self {
                    $($field: {
                        // SAFETY: the signature is the one in the vendor's header; the library is never unloaded, so that
                        // the copied pointer stays valid.
                        let found = unsafe {
                            library.get::<unsafe extern "system" fn($($argument),*) $(-> $result)?>($symbol)
                        };
                        *found.map_err(|_| $crate::OpenError::Symbol { symbol: $symbol })?
                    },)*
                })
            }
        }
    };
}
pub(crate) use functions;
