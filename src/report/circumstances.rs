//! Where and when a comparison was made: what a reader of a report wants to know, and results do not say.

use std::time::{SystemTime, UNIX_EPOCH};

/// What the comparison itself does not know.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// The command line.
    pub command: String,
    /// In universal time.
    pub when: String,
    /// Processor, how many of them, and system.
    pub machine: String,
    /// Name and version.
    pub program: String,
}

impl Circumstances {
    /// Here and now.
    pub fn of(program: &str, arguments: impl Iterator<Item = String>) -> Circumstances {
        let command: Vec<String> = arguments.map(quoted).collect();
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        Circumstances {
            command: command.join(" "),
            when: date(seconds),
            machine: machine(),
            program: format!("{program} {}", env!("CARGO_PKG_VERSION")),
        }
    }
}

/// An argument as a shell would take it.
fn quoted(argument: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+%@…".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument
    } else {
        format!("'{}'", argument.replace('\'', "'\\''"))
    }
}

/// Seconds since 1970 as "2026-11-25 02:31 UTC" (Hinnant, "chrono-compatible low-level date algorithms", civil_from_days).
fn date(seconds: u64) -> String {
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    // Days since 1 March of the year 0, in eras of 400 years.
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", second / 3600, second / 60 % 60)
}

fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let model = model.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    format!("{model}, {threads} processors, {}", std::env::consts::OS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        // As `date --utc --date=@…` prints them.
        for (seconds, text) in [
            (0, "1970-01-01 00:00 UTC"),
            (951_782_399, "2000-02-28 23:59 UTC"),
            (951_782_400, "2000-02-29 00:00 UTC"),
            (951_868_800, "2000-03-01 00:00 UTC"),
            (1_735_689_599, "2024-12-31 23:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00 UTC"),
        ] {
            assert_eq!(date(seconds), text);
        }
    }

    #[test]
    fn commands_can_be_pasted() {
        assert_eq!(quoted("--filter=depth=1..".into()), "--filter=depth=1..");
        assert_eq!(quoted("a b'c".into()), "'a b'\\''c'");
        assert_eq!(quoted(String::new()), "''");
    }
}
