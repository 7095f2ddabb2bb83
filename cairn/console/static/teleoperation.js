// Driving by hand: keyboard, pad and gamepad, each with a dead-man, and the commands that they cause.
//
// The robot moves only while a dead-man is held. It stops when the dead-man is let go, when the page loses
// the focus or is hidden, when commands are not answered, and (by the gateway and the velocity gate) when
// they cease to arrive.

import { Store } from "./store.js";

const PERIOD_MS = 50;
const ANSWER_LIMIT_MS = 1000;
const MOST_UNANSWERED = 6; // 0.3 s
const STICK_DEAD_ZONE = 0.12;
const DEAD_MAN_BUTTONS = [4, 5]; // shoulder buttons of the standard layout

const KEYS = {
  KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0],
  KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1],
};

const limit = (value) => Math.max(-1, Math.min(1, value));
const shaped = (axis) => (Math.abs(axis) < STICK_DEAD_ZONE ? 0 : limit((axis - Math.sign(axis) * STICK_DEAD_ZONE) / (1 - STICK_DEAD_ZONE)));

export class Teleoperation {
  /** {source: "" | "keyboard" | "pad" | "gamepad", speed [m/s], turn [rad/s], error}. */
  state = new Store({ source: "", speed: 0, turn: 0, error: "" });
  /** Name of the gamepad that is connected, "". */
  gamepad = new Store("");
  /** Highest speed [m/s] and turn rate [rad/s]. */
  limits = { speed: 0.3, turn: 0.8 };

  #connection;
  #robot = "";
  #held = new Set(); // codes of the keys that are held
  #deadMan = false; // of the keyboard
  #pad = null; // [speed share, turn share] while the pad is held
  #keyboardOn = false;
  #timer = 0;
  #unanswered = 0;
  #stamp = null;
  #blocked = false; // after an error, until the dead-man is let go
  #listeners = [];

  constructor(connection) {
    this.#connection = connection;
  }

  /** Listen to the keyboard and to what ends driving; `stop` undoes this. */
  start(robot) {
    this.#robot = robot;
    const listen = (target, name, listener, options) => {
      target.addEventListener(name, listener, options);
      this.#listeners.push(() => target.removeEventListener(name, listener, options));
    };
    listen(window, "keydown", (event) => this.#onKey(event, true), { capture: true });
    listen(window, "keyup", (event) => this.#onKey(event, false), { capture: true });
    listen(window, "blur", () => this.release());
    listen(window, "pagehide", () => this.release());
    listen(document, "visibilitychange", () => document.hidden && this.release());
    listen(window, "gamepadconnected", () => this.#findGamepad());
    listen(window, "gamepaddisconnected", () => this.#findGamepad());
    this.#listeners.push(this.#connection.status.subscribe(({ phase }) => phase !== "open" && this.release()));
    this.#findGamepad();
  }

  stop() {
    this.release();
    for (const end of this.#listeners) end();
    this.#listeners = [];
    clearInterval(this.#timer);
    this.#timer = 0;
  }

  /** Whether keys drive: only while this is switched on, so that no key moves a robot by chance. */
  set keyboard(on) {
    this.#keyboardOn = on;
    if (!on) this.#held.clear();
    this.#poll();
  }

  /** Hold the pad with these shares of speed and turn rate, from -1 to 1; null lets it go. */
  set pad(shares) {
    this.#pad = shares;
    this.#poll();
  }

  /** Let every dead-man go: the robot stops. */
  release() {
    this.#held.clear();
    this.#deadMan = false;
    this.#pad = null;
    this.#poll();
  }

  #onKey(event, down) {
    if (!this.#keyboardOn) return;
    this.#deadMan = event.shiftKey;
    const isTyping = event.target.closest?.("input:not([type=range]):not([type=checkbox]), textarea, select, [contenteditable]");
    if (event.code in KEYS && !isTyping && (event.shiftKey || !down)) {
      if (down) this.#held.add(event.code);
      else this.#held.delete(event.code);
      if (event.shiftKey) {
        event.preventDefault();
        event.stopPropagation();
      }
    }
    this.#poll();
  }

  #findGamepad() {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((one) => one?.connected);
    this.gamepad.set(pad?.id ?? "");
    this.#poll();
  }

  /** Return [source, speed share, turn share] of what is held, null if nothing is. */
  #wanted() {
    if (document.hidden) return null;
    if (this.#pad) return ["pad", ...this.#pad];
    if (this.#deadMan && this.#held.size > 0) {
      let [speed, turn] = [0, 0];
      for (const code of this.#held) {
        speed += KEYS[code][0];
        turn += KEYS[code][1];
      }
      return ["keyboard", limit(speed), limit(turn)];
    }
    if (this.gamepad.value && document.hasFocus())
      for (const pad of navigator.getGamepads())
        if (pad?.connected && DEAD_MAN_BUTTONS.some((button) => pad.buttons[button]?.pressed))
          return ["gamepad", -shaped(pad.axes[1] ?? 0), -shaped(pad.axes[2] ?? pad.axes[0] ?? 0)];
    return null;
  }

  /** Take what is held now; runs periodically while something is held or a gamepad is connected. */
  #poll() {
    const wanted = this.#wanted();
    if (wanted === null) {
      this.#blocked = false;
      if (this.state.value.source) this.#end("");
    } else if (!this.#blocked) this.#drive(...wanted);
    const isBusy = wanted !== null || Boolean(this.gamepad.value);
    if (isBusy && !this.#timer) this.#timer = setInterval(() => this.#poll(), PERIOD_MS);
    else if (!isBusy && this.#timer) {
      clearInterval(this.#timer);
      this.#timer = 0;
    }
  }

  #drive(source, speedShare, turnShare) {
    const speed = speedShare * this.limits.speed;
    const turn = turnShare * this.limits.turn;
    this.state.set({ source, speed, turn, error: "" });
    if (this.#unanswered >= MOST_UNANSWERED) return; // late commands would be worse than none
    this.#send(speed, turn);
  }

  #end(error) {
    this.state.set({ source: "", speed: 0, turn: 0, error });
    if (this.#connection.status.value.phase === "open") this.#send(0, 0);
  }

  async #send(speed, turn) {
    const command = { robot: this.#robot, speed, turn };
    // The stamp of the last answer shows the gateway how old this command is.
    if (this.#stamp !== null) command.stamp = this.#stamp;
    this.#unanswered += 1;
    try {
      const answer = await this.#connection.call("drive", command, { timeoutMs: ANSWER_LIMIT_MS });
      this.#stamp = answer?.stamp ?? null;
    } catch (error) {
      this.#stamp = null;
      if (speed !== 0 || turn !== 0) {
        this.#blocked = true;
        this.#end(error.message);
      }
    } finally {
      this.#unanswered -= 1;
    }
  }
}
