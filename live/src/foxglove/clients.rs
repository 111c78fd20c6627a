//! Controls from clients: those of the live page, as JSON on a topic whose name only the terminal shows.

use std::sync::Arc;

use foxglove::websocket::{Client, ClientChannel, ServerListener, Status};
use tokio::runtime::Handle;

use crate::server::{Answer, Control};

type Act = Arc<dyn Fn(&Control) -> Answer + Send + Sync>;

/// Longest control, bytes.
const LONGEST: usize = 4096;

/// Carries out the clients' controls.
pub(super) struct Clients {
    topic: String,
    runtime: Handle,
    act: Act,
    /// Lets one control be carried out at a time.
    turn: Arc<tokio::sync::Mutex<()>>,
}

impl Clients {
    pub fn new(
        topic: String,
        runtime: Handle,
        act: impl Fn(&Control) -> Answer + Send + Sync + 'static,
    ) -> Self {
        Self { topic, runtime, act: Arc::new(act), turn: Arc::default() }
    }

    fn understood(&self, channel: &ClientChannel, payload: &[u8]) -> Result<Control, String> {
        if channel.topic != self.topic {
            return Err(format!(
                "topic {} is not accepted: publish controls to the topic that whirlstand printed in its terminal",
                channel.topic
            ));
        }
        if payload.len() > LONGEST {
            return Err(format!("a control has at most {LONGEST} bytes"));
        }
        serde_json::from_slice(payload).map_err(|e| format!("this control cannot be parsed: {e}"))
    }
}

impl ServerListener for Clients {
    fn on_message_data(&self, client: Client, channel: &ClientChannel, payload: &[u8]) {
        let control = match self.understood(channel, payload) {
            Ok(control) => control,
            Err(text) => return client.send_status(Status::error(text)),
        };
        let (act, turn) = (self.act.clone(), self.turn.clone());
        self.runtime.spawn(async move {
            let _turn = turn.lock().await;
            let done = tokio::task::spawn_blocking(move || act(&control)).await;
            let answer = done.unwrap_or_else(|_| Err("the control failed inside the program".into()));
            client.send_status(match answer {
                Ok(text) => Status::info(text),
                Err(text) => Status::error(text),
            });
        });
    }
}
