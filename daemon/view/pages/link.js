// The WebSocket to `ramstroke view`: opened again and again, given up when nothing comes.

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 8000;
const SILENT_MS = 4000; // the server speaks once a second at least

export class Link {
  /** onMessage(message); onState("up" | "down" | "locked" | "full") */
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.pauseMs = FIRST_PAUSE_MS;
    this.open();
    for (const [target, event] of [[document, "visibilitychange"], [window, "online"]]) {
      target.addEventListener(event, () => this.hurry());
    }
  }

  open() {
    clearTimeout(this.timer);
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    this.socket = socket;
    this.refused = false;
    socket.onmessage = (event) => this.take(socket, event.data);
    socket.onclose = () => this.lose(socket);
    this.watch();
  }

  take(socket, data) {
    if (socket !== this.socket) return;
    this.watch();
    const message = JSON.parse(data);
    if (message.type === "refused") {
      this.refused = true;
      return;
    }
    this.pauseMs = FIRST_PAUSE_MS;
    this.onState("up");
    this.onMessage(message);
  }

  /** A network that fails silently closes nothing: then we do. */
  watch() {
    clearTimeout(this.watchdog);
    this.watchdog = setTimeout(() => this.lose(this.socket), SILENT_MS);
  }

  lose(socket) {
    if (socket !== this.socket) return;
    clearTimeout(this.watchdog);
    this.socket = null;
    socket.close();
    this.onState(this.refused ? "full" : "down");
    this.timer = setTimeout(() => this.again(), this.pauseMs * (0.75 + Math.random() / 2));
    this.pauseMs = Math.min(this.pauseMs * 1.7, LONGEST_PAUSE_MS);
  }

  /** A server that was started anew may want another token; a WebSocket does not say so. */
  async again() {
    if (!this.refused) {
      try {
        const answer = await fetch("/", { method: "HEAD" });
        if (answer.status === 401) this.onState("locked");
      } catch {
        // not there yet
      }
    }
    if (this.socket === null) this.open();
  }

  /** Somebody looks again, or the network has come back: no reason to wait. */
  hurry() {
    if (this.socket !== null || document.hidden) return;
    this.pauseMs = FIRST_PAUSE_MS;
    this.open();
  }
}
