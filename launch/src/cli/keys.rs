//! `whirlstand keys`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Keys of benches over Zenoh.
#[derive(Debug, Subcommand)]
pub(crate) enum KeysCommand {
    New(KeysNewArgs),
    Show(KeysShowArgs),
}

/// Create keys for a bench on several hosts: a certificate authority, and a key and a certificate for each node
/// (mutual TLS).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand keys new --host 192.0.2.1 --host 192.0.2.2 lab-keys\n\n\
    Name the folder in the launch file, [security] mode = \"tls\" and keys = \"lab-keys\", and copy ca.pem and the \
    files of a node to the host on which it runs. The authority's own key is not kept: to add a node, create new keys.")]
pub(crate) struct KeysNewArgs {
    /// New folder for the keys.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// A host on which nodes listen, by address or name, as the others connect to it; may be repeated. This host's
    /// loopback is always included.
    #[arg(long = "host", value_name = "HOST")]
    pub hosts: Vec<String>,
    /// A node besides plant, estimator, controller, recorder, launcher, observer and guest; may be repeated.
    #[arg(long = "node", value_name = "NODE")]
    pub nodes: Vec<String>,
}

/// Show the Zenoh configuration that your program needs to join a running bench.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand keys show lab --path\n  \
    python3 estimate_zenoh.py --bench lab --config \"$(whirlstand keys show lab --path)\"\n\n\
    The observer hears everything and publishes nothing; the guest also publishes topics of its own, inject, pilot \
    and adjust. The configuration contains a private key: whoever has it can act as that member until the run ends.")]
pub(crate) struct KeysShowArgs {
    /// Name of the bench, as given with `run --bench`.
    pub bench: String,
    /// observer, guest, or a node that the launch file calls external.
    #[arg(long, value_name = "NAME", default_value = "observer")]
    pub node: String,
    /// Print the path of the configuration instead of its contents.
    #[arg(long)]
    pub path: bool,
}
