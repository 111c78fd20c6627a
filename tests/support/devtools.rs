//! A page in a real headless browser, controlled through its developer tools over two pipes, without a port
//! (https://chromedevtools.github.io/devtools-protocol/, `--remote-debugging-pipe`).

use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Instant;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::HUNG;

/// A browser with one page; when it is dropped, its whole process group is killed.
pub struct Page {
    child: Child,
    words: ChildStdin,
    answers: Receiver<Value>,
    session: Value,
    asked: u64,
    _profile: TempDir,
}

impl Page {
    /// Opens an address.
    #[track_caller]
    pub fn open(browser: &Path, url: &str) -> Self {
        let profile = tempfile::tempdir().unwrap();
        // The browser reads on file 3 and writes on file 4.
        let mut command = Command::new("sh");
        command
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1"])
            .arg(browser)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--remote-debugging-pipe", "--window-size=1280,1400"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
        let words = child.stdin.take().expect("piped");
        let out = BufReader::new(child.stdout.take().expect("piped"));
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            for text in out.split(0).map_while(Result::ok) {
                let Ok(value) = serde_json::from_slice(&text) else { continue };
                if sender.send(value).is_err() {
                    break;
                }
            }
        });
        let mut page = Self { child, words, answers, session: Value::Null, asked: 0, _profile: profile };
        let target = page.ask("Target.createTarget", json!({ "url": url }))["targetId"].clone();
        let session = page.ask("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        page.session = session["sessionId"].clone();
        page
    }

    /// Goes to another address.
    #[track_caller]
    pub fn visit(&mut self, url: &str) {
        self.ask("Page.navigate", json!({ "url": url }));
    }

    /// The value of an expression in the page; a promise is waited for.
    #[track_caller]
    pub fn value(&mut self, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.ask("Runtime.evaluate", asked);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true, also in a page that is still being loaded.
    #[track_caller]
    pub fn wait_for(&mut self, expression: &str) {
        let until = Instant::now() + HUNG;
        let promise = format!(
            "new Promise((done) => {{ const end = Date.now() + 1000; const look = () => {{ let is = false; try {{ is = !!({expression}); }} \
             catch {{}} if (is || Date.now() > end) done(is); else setTimeout(look, 20); }}; look(); }})"
        );
        while Instant::now() < until {
            let asked = json!({ "expression": promise, "awaitPromise": true, "returnByValue": true });
            // A page that was replaced in between gives no answer.
            if self.ask("Runtime.evaluate", asked)["result"]["value"] == true {
                return;
            }
        }
        let text = self.ask("Runtime.evaluate", json!({ "expression": "document.body.innerText" }));
        panic!("never true: {expression}\n{}", text["result"]["value"].as_str().unwrap_or_default());
    }

    /// The mouse: `mousePressed`, `mouseMoved` or `mouseReleased` with its left button, at a place in the window.
    #[track_caller]
    pub fn mouse(&mut self, what: &str, x: f64, y: f64) {
        let held = if what == "mouseReleased" { 0 } else { 1 };
        let event =
            json!({ "type": what, "x": x, "y": y, "button": "left", "buttons": held, "clickCount": 1 });
        self.ask("Input.dispatchMouseEvent", event);
    }

    /// Sets a property of the page's environment, as a device would.
    #[track_caller]
    pub fn emulate(&mut self, what: &str, parameters: Value) {
        self.ask(&format!("Emulation.{what}"), parameters);
    }

    #[track_caller]
    fn ask(&mut self, method: &str, parameters: Value) -> Value {
        self.asked += 1;
        let mut request = json!({ "id": self.asked, "method": method, "params": parameters });
        if !self.session.is_null() {
            request["sessionId"] = self.session.clone();
        }
        self.words.write_all(format!("{request}\0").as_bytes()).expect("the browser listens");
        let until = Instant::now() + HUNG;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let answer = self.answers.recv_timeout(left).unwrap_or_else(|e| panic!("{method}: {e}"));
            if answer["id"] == self.asked {
                return answer["result"].clone();
            }
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // SAFETY: kill(2) touches no memory of ours; the group is the one that was made for this child.
        unsafe { libc::kill(-(self.child.id() as i32), libc::SIGKILL) };
        let _ = self.child.wait();
    }
}
