//! Drives a headless browser over a pipe (Chrome DevTools Protocol).
//!
//! The adapter is a software one (SwiftShader), so that a machine without a graphics card does as well.

use std::{
    fs::{File, OpenOptions},
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::Duration,
};

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Programs that are such a browser.
const PROGRAMS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// Without a window, WebGPU in software, nothing fetched of its own accord.
const FLAGS: [&str; 13] = [
    "--headless=new",
    "--no-sandbox",
    "--enable-unsafe-webgpu",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-angle=swiftshader",
    "--remote-debugging-pipe",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--mute-audio",
    "--force-device-scale-factor=1",
];
/// Longest wait for one answer.
const TIMEOUT: Duration = Duration::from_secs(300);

/// A browser with one page. It ends when this is dropped.
pub struct Browser {
    child: Child,
    orders: File,
    answers: Receiver<Vec<u8>>,
    session: Option<String>,
    last: u64,
    /// What the page has complained of: errors and warnings of its console.
    pub complaints: Vec<String>,
    _folder: TempDir,
}

impl Browser {
    /// The program, if one is installed.
    pub fn program() -> Option<PathBuf> {
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let folders: Vec<PathBuf> = std::env::split_paths(&folders).collect();
        let places = PROGRAMS.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
        places.into_iter().find(|place| place.is_file())
    }

    /// Opens a page of `width` × `height` pixels.
    ///
    /// # Errors
    /// The program is missing or does not answer.
    pub fn open(width: u32, height: u32) -> Result<Self> {
        let program =
            Self::program().with_context(|| format!("none of {} is installed", PROGRAMS.join(", ")))?;
        let folder = tempfile::tempdir()?;
        let pipes = ["orders", "answers"].map(|name| folder.path().join(name));
        let made = Command::new("mkfifo").args(&pipes).status().context("mkfifo")?;
        ensure!(made.success(), "mkfifo: {made}");
        // The browser reads file 3 and writes file 4, which a shell opens for it.
        let mut command = Command::new("sh");
        command
            .args(["-c", "in=$1 out=$2; shift 2; exec \"$@\" 3<\"$in\" 4>\"$out\"", "sh"])
            .args(&pipes)
            .arg(program)
            .args(FLAGS)
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .arg(format!("--window-size={width},{height}"))
            .arg("about:blank");
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let orders = OpenOptions::new().write(true).open(&pipes[0])?;
        let answers = listen(File::open(&pipes[1])?);
        let (session, last, complaints) = (None, 0, Vec::new());
        let mut browser = Self { child, orders, answers, session, last, complaints, _folder: folder };
        browser.attach()?;
        browser.resize(width, height)?;
        Ok(browser)
    }

    fn attach(&mut self) -> Result<()> {
        let targets = self.order("Target.getTargets", json!({}))?;
        let pages = targets["targetInfos"].as_array().cloned().unwrap_or_default();
        let page = pages.iter().find(|target| target["type"] == "page").context("no page is open")?;
        let attached =
            self.order("Target.attachToTarget", json!({ "targetId": page["targetId"], "flatten": true }))?;
        self.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "DOM"] {
            self.order(&format!("{domain}.enable"), json!({}))?;
        }
        Ok(())
    }

    /// Makes the page `width` × `height` pixels.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn resize(&mut self, width: u32, height: u32) -> Result<()> {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.order("Emulation.setDeviceMetricsOverride", size).map(|_| ())
    }

    /// Lets no more than `bits_per_s` through to the page, each answer after `delay_ms` more.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn hold_to(&mut self, bits_per_s: f64, delay_ms: f64) -> Result<()> {
        let bytes = bits_per_s / 8.0;
        let wish = json!({
            "offline": false, "latency": delay_ms, "downloadThroughput": bytes, "uploadThroughput": bytes,
        });
        self.order("Network.enable", json!({}))?;
        self.order("Network.emulateNetworkConditions", wish).map(|_| ())
    }

    /// Goes to `url`; what the page does is not waited for.
    ///
    /// # Errors
    /// The browser cannot go there.
    pub fn go(&mut self, url: &str) -> Result<()> {
        let answer = self.order("Page.navigate", json!({ "url": url }))?;
        match answer["errorText"].as_str() {
            Some(error) => bail!("{url}: {error}"),
            None => Ok(()),
        }
    }

    /// Runs `script` in every page from now on, before its own scripts.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn before_pages(&mut self, script: &str) -> Result<()> {
        self.order("Page.addScriptToEvaluateOnNewDocument", json!({ "source": script })).map(|_| ())
    }

    /// The value of the JavaScript expression `script`, waited for if it is a promise.
    ///
    /// # Errors
    /// What it throws.
    pub fn run(&mut self, script: &str) -> Result<Value> {
        let wish = json!({ "expression": script, "awaitPromise": true, "returnByValue": true });
        let answer = self.order("Runtime.evaluate", wish)?;
        if let Some(thrown) = answer.get("exceptionDetails") {
            let text = thrown["exception"]["description"].as_str().or_else(|| thrown["text"].as_str());
            bail!("{}: {script}", text.unwrap_or("an exception without words"));
        }
        Ok(answer["result"]["value"].clone())
    }

    /// Runs `script` until its value is true, ten times a second.
    ///
    /// # Errors
    /// It is not after `seconds`.
    pub fn wait(&mut self, seconds: u32, script: &str) -> Result<()> {
        for _ in 0..10 * seconds {
            // While a page comes, there is nothing to ask.
            if self.run(script).is_ok_and(|value| value == true) {
                return Ok(());
            }
            thread::sleep(Duration::from_millis(100));
        }
        Err(anyhow!("after {seconds} s still not: {script}; complaints: {:?}", self.complaints))
    }

    /// Moves the mouse along `path` with `button` down.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn drag(&mut self, path: &[[f64; 2]], button: &str) -> Result<()> {
        let (Some(&first), Some(&last)) = (path.first(), path.last()) else { return Ok(()) };
        let pressed = if button == "right" { 2 } else { 1 };
        let mut mouse = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let mut event = json!({ "type": kind, "x": x, "y": y, "button": button });
            (event["buttons"], event["clickCount"]) = (json!(buttons), json!(1));
            self.order("Input.dispatchMouseEvent", event)
        };
        mouse("mousePressed", first, pressed)?;
        for &at in path {
            mouse("mouseMoved", at, pressed)?;
        }
        mouse("mouseReleased", last, 0).map(|_| ())
    }

    /// Puts a finger on each place of the first entry of `path`, CSS pixels, moves them through the others,
    /// and lifts them.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn touch(&mut self, path: &[&[[f64; 2]]]) -> Result<()> {
        for (at, fingers) in path.iter().enumerate() {
            let points = fingers.iter().enumerate().map(|(id, [x, y])| json!({ "x": x, "y": y, "id": id }));
            let kind = if at == 0 { "touchStart" } else { "touchMove" };
            let points: Vec<Value> = points.collect();
            self.order("Input.dispatchTouchEvent", json!({ "type": kind, "touchPoints": points }))?;
        }
        self.order("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] })).map(|_| ())
    }

    /// Drags the file at `path` over the place `[x, y]` of the page, CSS pixels, and drops it there. A page
    /// that has not said in time that it takes it gets no drop.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn drop_file(&mut self, [x, y]: [f64; 2], path: &Path) -> Result<()> {
        let data = json!({ "items": [], "files": [path], "dragOperationsMask": 1 });
        for kind in ["dragEnter", "dragOver", "dragOver", "drop"] {
            let event = json!({ "type": kind, "x": x, "y": y, "data": data });
            self.order("Input.dispatchDragEvent", event)?;
            // What the page says to that comes by another way.
            thread::sleep(Duration::from_millis(200));
        }
        Ok(())
    }

    /// Presses `key`, named as in JavaScript's events.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn press(&mut self, key: &str) -> Result<()> {
        let text = if key.chars().count() == 1 { key } else { "" };
        self.order("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": key, "text": text }))?;
        self.order("Input.dispatchKeyEvent", json!({ "type": "keyUp", "key": key })).map(|_| ())
    }

    /// Chooses the file at `path` in the input that `css` finds.
    ///
    /// # Errors
    /// There is no such input.
    pub fn choose_file(&mut self, css: &str, path: &Path) -> Result<()> {
        let root = self.order("DOM.getDocument", json!({}))?;
        let wish = json!({ "nodeId": root["root"]["nodeId"], "selector": css });
        let input = self.order("DOM.querySelector", wish)?;
        self.order("DOM.setFileInputFiles", json!({ "nodeId": input["nodeId"], "files": [path] })).map(|_| ())
    }

    /// The page as JPEG.
    ///
    /// # Errors
    /// The browser does not answer.
    pub fn picture(&mut self, quality: u32) -> Result<Vec<u8>> {
        let wish = json!({ "format": "jpeg", "quality": quality });
        let answer = self.order("Page.captureScreenshot", wish)?;
        from_base64(answer["data"].as_str().unwrap_or_default())
    }

    fn order(&mut self, method: &str, parameters: Value) -> Result<Value> {
        self.last += 1;
        let mut order = json!({ "id": self.last, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            order["sessionId"] = json!(session);
        }
        let mut bytes = order.to_string().into_bytes();
        bytes.push(0);
        self.orders.write_all(&bytes).context("the browser is gone")?;
        loop {
            let answer: Value = match self.answers.recv_timeout(TIMEOUT) {
                Ok(message) => serde_json::from_slice(&message).context("the browser's answer")?,
                Err(RecvTimeoutError::Timeout) => bail!("{method}: no answer in {TIMEOUT:?}"),
                Err(RecvTimeoutError::Disconnected) => bail!("{method}: the browser is gone"),
            };
            if answer["id"] != self.last {
                self.hear(&answer);
                continue;
            }
            return match answer.get("error") {
                Some(error) => Err(anyhow!("{method}: {error}")),
                None => Ok(answer["result"].clone()),
            };
        }
    }

    /// Keeps what a page complains of.
    fn hear(&mut self, event: &Value) {
        let said = &event["params"];
        let complaint = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => said["exceptionDetails"].to_string(),
            Some("Runtime.consoleAPICalled")
                if ["error", "warning"].iter().any(|kind| said["type"] == *kind) =>
            {
                said["args"].to_string()
            }
            Some("Log.entryAdded") if said["entry"]["level"] == "error" => said["entry"].to_string(),
            _ => return,
        };
        self.complaints.push(complaint);
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It ends by itself when asked; where it does not answer, it is ended.
        let _ = self.orders.write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        for _ in 0..30 {
            if self.child.try_wait().is_ok_and(|ended| ended.is_some()) {
                return;
            }
            thread::sleep(Duration::from_millis(100));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Messages of `pipe`, each ended by a zero.
fn listen(mut pipe: File) -> Receiver<Vec<u8>> {
    let (send, receive) = channel();
    thread::spawn(move || {
        let (mut rest, mut piece) = (Vec::new(), vec![0; 1 << 16]);
        while let Ok(read @ 1..) = pipe.read(&mut piece) {
            for &byte in &piece[..read] {
                if byte != 0 {
                    rest.push(byte);
                } else if send.send(std::mem::take(&mut rest)).is_err() {
                    return;
                }
            }
        }
    });
    receive
}

/// Bytes of standard base64 (RFC 4648) with padding.
fn from_base64(text: &str) -> Result<Vec<u8>> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => Ok(c - b'A'),
        b'a'..=b'z' => Ok(c - b'a' + 26),
        b'0'..=b'9' => Ok(c - b'0' + 52),
        b'+' => Ok(62),
        b'/' => Ok(63),
        _ => Err(anyhow!("{:?} is no character of base64", char::from(c))),
    };
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut waiting) = (0u32, 0);
    for c in text.trim_end_matches('=').bytes() {
        bits = bits << 6 | u32::from(value(c)?);
        waiting += 6;
        if waiting >= 8 {
            waiting -= 8;
            out.push((bits >> waiting) as u8);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_read() {
        for (text, bytes) in [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYmE=", "fooba")]
        {
            assert_eq!(from_base64(text).unwrap(), bytes.as_bytes());
        }
        assert!(from_base64("Zm9*").is_err());
    }
}
