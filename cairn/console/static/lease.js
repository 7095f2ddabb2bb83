// The lease: who steers, and how it changes hands.

import { html } from "./vendor/preact-htm.js";
import { toast, useAction, useApp, useEvent } from "./hooks.js";
import { useStore } from "./store.js";
import { Badge, Icon } from "./ui.js";

const FREE = { holder: "", mine: false, asked_by: "", asked_by_me: false, limits: null };

/** Return {holder, mine, asked_by, asked_by_me, limits} of the chosen robot; free before the first event. */
export function useLease() {
  return useEvent("lease", { ofRobot: true }) ?? FREE;
}

/** The chip of the top bar: who steers, and the button to take, ask for or give up the lease. */
export function LeaseControl() {
  const { connection } = useApp();
  const lease = useLease();
  const act = useAction();
  if (useStore(connection.hello)?.may === "watch")
    return html`<span class="chip lease"><span class="label">Lease</span><${Badge} title="This console may not steer">watch only<//></span>`;
  const ask = async () => {
    if ((await act("ask_lease")) !== undefined) toast("info", `Asked ${lease.holder || "the operator"} for the lease.`);
  };
  if (lease.mine && lease.asked_by)
    return html`
      <span class="chip attention" role="alert">
        <span><strong>${lease.asked_by}</strong> asks to steer</span>
        <button class="button small primary" onClick=${() => act("answer_lease", { grant: true })}>Give</button>
        <button class="button small" onClick=${() => act("answer_lease", { grant: false })}>Keep</button>
      </span>`;
  return html`
    <span class="chip lease">
      <span class="label">Lease</span>
      ${lease.mine
        ? html`<${Badge} tone="ok" title="You steer this robot; others watch">you steer<//>
            <button class="button small" onClick=${() => act("release_lease")}>Release</button>`
        : lease.holder
          ? html`<${Badge} tone="warning" title="Another operator steers">${lease.holder}<//>
              <button class="button small" disabled=${lease.asked_by_me} onClick=${ask}>${lease.asked_by_me ? "Asked" : "Ask"}</button>`
          : html`<span class="muted">free</span>
              <button class="button small primary" onClick=${() => act("acquire_lease")}><${Icon} name="lock" size=${14} />Steer</button>`}
    </span>`;
}
