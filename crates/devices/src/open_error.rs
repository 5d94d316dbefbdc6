/// Why a device could not be opened. Each is one line that says what, where and the mend.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A library or service is not there.
    #[error("{what} was not found (sought: {sought}); {mend}")]
    Missing {
        /// What is missing.
        what: &'static str,
        /// Where it was sought.
        sought: String,
        /// What the user can do.
        mend: String,
    },
    /// The library is not the one it should be.
    #[error("the library lacks the function {symbol}; install the vendor's current version")]
    Symbol {
        /// The missing function.
        symbol: &'static str,
    },
    /// The library or service is there, but no device of it can be used.
    #[error("{driver}: {message}")]
    Refused {
        /// Which driver.
        driver: &'static str,
        /// Its reason.
        message: String,
    },
    /// None with the serial number asked for, or several without one.
    #[error("{driver}: {problem}; there is {present}")]
    Choice {
        /// Which driver.
        driver: &'static str,
        /// What is wrong with the choice.
        problem: String,
        /// What there is.
        present: String,
    },
    /// A thread or socket.
    #[error("{what}: {error}")]
    Io {
        /// What was tried.
        what: String,
        /// The system's reason.
        error: std::io::Error,
    },
}
