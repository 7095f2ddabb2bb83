// What every part of the page uses: the application's context, topics, events, calls and messages
// to the user.

import { createContext, useCallback, useContext, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import { Store, useStore } from "./store.js";

/** {connection, robot: Store of the chosen robot's name, theme: Store, mode, showPanel(id)}: see main.js. */
export const AppContext = createContext(null);
export const useApp = () => useContext(AppContext);

/** Return the name of the chosen robot, "" before there is one. */
export const useRobot = () => useStore(useApp().robot);

/** Return the full name of a robot's topic: "scan" is "/robot/scan", "/rosout" stays. */
export const topicOf = (robot, name) => (name.startsWith("/") ? name : `/${robot}/${name}`);

/** Return the last value of an event; with `ofRobot` of the last one about the chosen robot. */
export function useEvent(name, { ofRobot = false } = {}) {
  const { connection } = useApp();
  const robot = useRobot();
  return useStore(connection.event(name, ofRobot ? robot : null));
}

/** Return whether the browser shows this tab. */
export function usePageVisible() {
  const [visible, setVisible] = useState(!document.hidden);
  useEffect(() => {
    const update = () => setVisible(!document.hidden);
    document.addEventListener("visibilitychange", update);
    update();
    return () => document.removeEventListener("visibilitychange", update);
  }, []);
  return visible;
}

/**
 * Call `listener(message, info)` with each message of a topic ("scan", "/rosout"; null for none).
 *
 * `options` are those of `Connection.subscribe`. The listener may change from render to render. A tab that
 * is hidden does not subscribe: it costs neither the console nor the browser anything.
 */
export function useSubscription(name, listener, { maxHz = 0, jpeg = false } = {}) {
  const { connection } = useApp();
  const robot = useRobot();
  const visible = usePageVisible();
  const current = useRef(listener);
  current.current = listener;
  useEffect(() => {
    if (!visible || !name || (!robot && !name.startsWith("/"))) return undefined;
    return connection.subscribe(topicOf(robot, name), (...message) => current.current(...message), { maxHz, jpeg });
  }, [connection, robot, name, maxHz, jpeg, visible]);
}

/** Return the last message of a topic, null before the first one. Renders once per frame at most. */
export function useTopic(name, options = {}) {
  const robot = useRobot();
  const [state, setState] = useState({ key: "", message: null });
  const latest = useRef(null);
  const frame = useRef(0);
  const key = `${robot} ${name}`;
  useSubscription(name, (message) => {
    latest.current = { key, message };
    if (frame.current) return;
    frame.current = requestAnimationFrame(() => {
      frame.current = 0;
      setState(latest.current);
    });
  }, options);
  useEffect(() => () => cancelAnimationFrame(frame.current), []);
  return state.key === key ? state.message : null;
}

/** Messages to the user: [{id, level: "info" | "warning" | "error", text}]. */
export const toasts = new Store([]);
let lastToast = 0;

/** Show a message for some seconds; one with the same text replaces the older one. */
export function toast(level, text) {
  const id = ++lastToast;
  toasts.update((list) => [...list.filter((one) => one.text !== text), { id, level, text }].slice(-4));
  setTimeout(() => dismiss(id), level === "info" ? 4000 : 9000);
}

export const dismiss = (id) => toasts.update((list) => list.filter((one) => one.id !== id));

/**
 * Return `act(method, arguments, options)`: calls a method of the gateway for the chosen robot.
 *
 * It resolves to the method's value, or shows the error and resolves to undefined.
 */
export function useAction() {
  const { connection } = useApp();
  const robot = useRobot();
  return useCallback(
    async (method, parameters = {}, options = {}) => {
      try {
        return await connection.call(method, { robot, ...parameters }, options);
      } catch (error) {
        toast("error", error.message);
        return undefined;
      }
    },
    [connection, robot],
  );
}

/** Call `tick` every `periodMs` while the component is shown and the tab is visible. */
export function useInterval(tick, periodMs) {
  const current = useRef(tick);
  current.current = tick;
  useEffect(() => {
    const timer = setInterval(() => document.hidden || current.current(), periodMs);
    return () => clearInterval(timer);
  }, [periodMs]);
}
