// The connection to the console's gateway: subprotocol "cairn.console.v1" over one WebSocket.
//
// It reconnects by itself, subscribes again, and decodes messages. docs/reference/console-protocol.md
// describes the protocol.

import { makeDecoder } from "./cdr.js";
import { Store } from "./store.js";

const SUBPROTOCOL = "cairn.console.v1";
const CALL_LIMIT_MS = 10_000;
const FIRST_RETRY_MS = 500;
const LONGEST_RETRY_MS = 8_000;
const OPENING_LIMIT_MS = 8_000; // until the event "hello"
const SILENT_MS = 3_000; // then the console is asked for a sign of life
const DEAD_MS = 6_000; // then the link counts as lost: a socket may take minutes to notice
const WRONG_TOKEN = 4401; // close code
const MESSAGE_DATA = 0x01;
const STATUS_LEVELS = ["info", "warning", "error"];
const MOST_NOTICES = 50;

/** A call that the gateway rejected, or that could not be made; the message says why. */
export class CallError extends Error {}

export class Connection {
  /**
   * {phase, reason, retryAt}: phase is "connecting", "open", "waiting" (for the next attempt, at
   * `retryAt` of performance.now()), "refused" (a wrong token) or "closed".
   */
  status = new Store({ phase: "connecting", reason: "", retryAt: 0 });
  /** The event "hello": {version, mode, robots, may, recording}; null before the first one. */
  hello = new Store(null);
  /** Topics that exist: Map of name -> {topic, type, channels}. A new Map with each change. */
  topics = new Store(new Map());
  /** What the gateway reports: [{level, message, at}], newest last. */
  notices = new Store([]);

  #url;
  #socket = null;
  #retries = 0;
  #timer = 0;
  #watchdog = 0;
  #heardAt = 0;
  #nextId = 1;
  #calls = new Map(); // id -> {resolve, reject, timer}
  #channels = new Map(); // id -> channel as advertised, with `decode`
  #subscriptions = new Map(); // key -> {topic, options, listeners, ids}
  #byId = new Map(); // subscription id on the wire -> {subscription, channel}
  #events = new Map();

  /** `url` is the address of the WebSocket, token included. */
  constructor(url) {
    this.#url = url;
  }

  open() {
    clearTimeout(this.#timer);
    this.status.set({ phase: "connecting", reason: this.status.value.reason, retryAt: 0 });
    let socket;
    try {
      socket = new WebSocket(this.#url, [SUBPROTOCOL]);
    } catch (error) {
      this.status.set({ phase: "closed", reason: String(error.message), retryAt: 0 });
      return;
    }
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#timer = setTimeout(() => this.#giveUp(socket, "the console does not answer"), OPENING_LIMIT_MS);
    socket.onmessage = (event) => {
      if (socket !== this.#socket) return;
      this.#heardAt = performance.now();
      if (typeof event.data === "string") this.#onText(event.data);
      else this.#onBinary(event.data);
    };
    socket.onclose = (event) => {
      if (socket === this.#socket) this.#onClose(event);
    };
  }

  /** Connect now instead of at the next attempt. */
  retry() {
    if (this.status.value.phase === "waiting") this.open();
  }

  close() {
    clearTimeout(this.#timer);
    clearInterval(this.#watchdog);
    this.#watchdog = 0;
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
    this.#drop("the connection was closed");
    this.status.set({ phase: "closed", reason: "closed", retryAt: 0 });
  }

  /** A store with the last value of an event; with `robot` of the last one about that robot. */
  event(name, robot = null) {
    const key = robot === null ? name : `${name} ${robot}`;
    if (!this.#events.has(key)) this.#events.set(key, new Store(null));
    return this.#events.get(key);
  }

  /** Call a method of the gateway. The promise is rejected with a `CallError`. */
  call(method, parameters = {}, { timeoutMs = CALL_LIMIT_MS } = {}) {
    return new Promise((resolve, reject) => {
      if (this.status.value.phase !== "open") {
        reject(new CallError(`${method}: not connected to the console`));
        return;
      }
      const id = this.#nextId++;
      const timer = setTimeout(() => {
        this.#calls.delete(id);
        reject(new CallError(`${method}: no answer within ${timeoutMs / 1000} s`));
      }, timeoutMs);
      this.#calls.set(id, { resolve, reject, timer });
      this.#send({ op: "call", id, method, arguments: parameters });
    });
  }

  /** Bytes that the browser has not sent yet: a call that must be fresh is not worth making then. */
  get backlog() {
    return this.#socket?.bufferedAmount ?? 0;
  }

  /**
   * Call `listener(message, info)` with each message of a topic, from all of its publishers.
   *
   * `info` is {topic, type, receivedNs: BigInt, bytes, channel}. With `jpeg`, the message of an image
   * topic is {width, height, jpeg: Blob}. `maxHz` limits the rate at the gateway. The topic need not
   * exist yet. Returns a function that ends the subscription.
   */
  subscribe(topic, listener, { maxHz = 0, jpeg = false } = {}) {
    const key = `${topic} ${maxHz} ${jpeg}`;
    let subscription = this.#subscriptions.get(key);
    if (!subscription) {
      subscription = { topic, maxHz, jpeg, listeners: new Set(), last: new Map(), ids: new Map() };
      this.#subscriptions.set(key, subscription);
      for (const channel of this.#channels.values()) this.#subscribeTo(subscription, channel);
    } else {
      // Later listeners get what the first one got: a latched message comes only once.
      for (const [message, info] of subscription.last.values()) listener(message, info);
    }
    subscription.listeners.add(listener);
    return () => {
      subscription.listeners.delete(listener);
      if (subscription.listeners.size > 0 || this.#subscriptions.get(key) !== subscription) return;
      this.#subscriptions.delete(key);
      const ids = [...subscription.ids.values()];
      for (const id of ids) this.#byId.delete(id);
      if (ids.length > 0) this.#send({ op: "unsubscribe", subscriptionIds: ids });
    };
  }

  /** Return the decoder of a topic's messages, null while the topic does not exist. */
  decoder(topic) {
    for (const channel of this.#channels.values()) if (channel.topic === topic) return channel.decode;
    return null;
  }

  notice(level, message) {
    this.notices.update((list) => [...list.slice(1 - MOST_NOTICES), { level, message, at: Date.now() }]);
  }

  #send(value) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(value));
  }

  /** Close a link on which nothing arrives any more, without waiting for the other side. */
  #watch() {
    const silent = performance.now() - this.#heardAt;
    if (this.status.value.phase !== "open") return;
    if (silent > DEAD_MS) this.#giveUp(this.#socket, `nothing has arrived from the console for ${DEAD_MS / 1000} s`);
    else if (silent > SILENT_MS) this.call("ping", {}, { timeoutMs: SILENT_MS }).catch(() => {});
  }

  #giveUp(socket, reason) {
    if (socket !== this.#socket) return;
    socket.close();
    this.#onClose({ code: 0, reason });
  }

  #onClose(event) {
    clearTimeout(this.#timer);
    clearInterval(this.#watchdog);
    this.#watchdog = 0;
    this.#socket = null;
    const wasOpen = this.status.value.phase === "open";
    this.#drop("the connection to the console was lost");
    if (event.code === WRONG_TOKEN) {
      this.status.set({ phase: "refused", reason: event.reason || "the token is missing or wrong", retryAt: 0 });
      return;
    }
    const reason =
      event.reason || (wasOpen ? "the console closed the connection" : "the console does not answer");
    const wait = Math.min(LONGEST_RETRY_MS, FIRST_RETRY_MS * 2 ** this.#retries) * (0.8 + 0.4 * Math.random());
    this.#retries += 1;
    this.status.set({ phase: "waiting", reason, retryAt: performance.now() + wait });
    this.#timer = setTimeout(() => this.open(), wait);
  }

  #drop(reason) {
    for (const { reject, timer } of this.#calls.values()) {
      clearTimeout(timer);
      reject(new CallError(reason));
    }
    this.#calls.clear();
    this.#channels.clear();
    this.#byId.clear();
    for (const subscription of this.#subscriptions.values()) {
      subscription.ids.clear();
      subscription.last.clear();
    }
    for (const store of this.#events.values()) store.set(null);
    this.#publishTopics();
  }

  #onText(data) {
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      this.notice("error", "the console sent text that is not JSON");
      return;
    }
    switch (message.op) {
      case "event":
        this.#onEvent(message.name, message.value);
        break;
      case "result":
        this.#onResult(message);
        break;
      case "advertise":
        for (const channel of message.channels) this.#advertise(channel);
        this.#publishTopics();
        break;
      case "unadvertise":
        for (const id of message.channelIds) this.#unadvertise(id);
        this.#publishTopics();
        break;
      case "status":
        this.notice(STATUS_LEVELS[message.level] ?? "info", message.message);
        break;
    }
  }

  #onEvent(name, value) {
    if (name === "hello") {
      clearTimeout(this.#timer);
      this.#retries = 0;
      this.#watchdog ||= setInterval(() => this.#watch(), 1000);
      this.hello.set(value);
      this.status.set({ phase: "open", reason: "", retryAt: 0 });
    }
    this.event(name).set(value);
    if (value?.robot !== undefined) this.event(name, value.robot).set(value);
  }

  #onResult({ id, value, error }) {
    const call = this.#calls.get(id);
    if (!call) return; // it has timed out
    this.#calls.delete(id);
    clearTimeout(call.timer);
    if (error !== undefined) call.reject(new CallError(error));
    else call.resolve(value);
  }

  #advertise(channel) {
    try {
      channel.decode = channel.encoding === "cdr" && channel.schema ? makeDecoder(channel.schemaName, channel.schema) : null;
    } catch (error) {
      channel.decode = null;
      this.notice("warning", `${channel.topic}: ${error.message}`);
    }
    this.#channels.set(channel.id, channel);
    for (const subscription of this.#subscriptions.values()) this.#subscribeTo(subscription, channel);
  }

  #unadvertise(id) {
    this.#channels.delete(id);
    for (const subscription of this.#subscriptions.values()) {
      this.#byId.delete(subscription.ids.get(id));
      subscription.ids.delete(id);
      subscription.last.delete(id);
    }
  }

  #subscribeTo(subscription, channel) {
    if (channel.topic !== subscription.topic || subscription.ids.has(channel.id)) return;
    const id = this.#nextId++;
    subscription.ids.set(channel.id, id);
    this.#byId.set(id, { subscription, channel });
    const request = { id, channelId: channel.id };
    if (subscription.maxHz > 0) request.maxHz = subscription.maxHz;
    if (subscription.jpeg) request.jpeg = true;
    this.#send({ op: "subscribe", subscriptions: [request] });
  }

  #onBinary(buffer) {
    const view = new DataView(buffer);
    if (buffer.byteLength < 13 || view.getUint8(0) !== MESSAGE_DATA) return;
    const target = this.#byId.get(view.getUint32(1, true));
    if (!target) return; // just unsubscribed
    const { subscription, channel } = target;
    const bytes = new Uint8Array(buffer, 13);
    const info = {
      topic: channel.topic,
      type: channel.schemaName,
      channel: channel.id,
      receivedNs: view.getBigUint64(5, true),
      bytes: bytes.byteLength,
    };
    let message;
    try {
      if (subscription.jpeg) message = jpegImage(bytes);
      else if (channel.decode) message = channel.decode(bytes);
      else return;
    } catch (error) {
      if (!channel.complained) this.notice("warning", `${channel.topic}: ${error.message}`);
      channel.complained = true;
      return;
    }
    subscription.last.set(channel.id, [message, info]);
    for (const listener of [...subscription.listeners]) listener(message, info);
  }

  #publishTopics() {
    const topics = new Map();
    for (const channel of this.#channels.values()) {
      const known = topics.get(channel.topic);
      if (known) known.channels += 1;
      else topics.set(channel.topic, { topic: channel.topic, type: channel.schemaName, channels: 1 });
    }
    this.topics.set(new Map([...topics].sort(([a], [b]) => (a < b ? -1 : 1))));
  }
}

function jpegImage(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const blob = new Blob([bytes.subarray(8)], { type: "image/jpeg" });
  return { width: view.getUint32(0, true), height: view.getUint32(4, true), jpeg: blob };
}

/** Return the gateway's WebSocket address for this page, with the token of its address. */
export function gatewayUrl() {
  const fragment = new URLSearchParams(location.hash.slice(1));
  const given = fragment.get("token");
  if (given) {
    // Out of the address bar, so that a screenshot or a copied address does not contain it.
    sessionStorage.setItem("cairn.token", given);
    fragment.delete("token");
    const rest = fragment.toString();
    history.replaceState(null, "", location.pathname + location.search + (rest ? `#${rest}` : ""));
  }
  const url = new URL("ws", location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  url.search = url.hash = "";
  const token = sessionStorage.getItem("cairn.token");
  if (token) url.searchParams.set("token", token);
  return url.href;
}
