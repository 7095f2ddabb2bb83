// Things that the robot proposes as landmarks: their pictures and places, to be accepted or rejected.

import { html, useEffect, useMemo, useState } from "../vendor/preact-htm.js";
import { toast, useAction, useTopic } from "../hooks.js";
import { Empty } from "../ui.js";
import { Facts, number, ReadOnlyNote, useReadOnly } from "./shared.js";

const LONGEST_NAME = 100;

/** Return the facts about a proposal, [name, value] each. */
export function factsOf({ x, y, covariance, width, height, seen }) {
  const deviation = Math.sqrt(covariance[0] + covariance[3]);
  return [
    ["Place", `${number(round(x))}, ${number(round(y))} m`],
    ["Deviation", `${number(round(deviation))} m`],
    ["Size", `${number(round(width))} × ${number(round(height))} m`],
    ["Recognized", `${seen} times`],
  ];
}

export function Proposals() {
  const message = useTopic("object_proposals");
  const readOnly = useReadOnly();
  if (!message)
    return html`<div class="panel"><${Empty} icon="proposal" title="Nothing finds new landmarks">
      Start the robot with the overlay <code>find_objects</code>: then it proposes things that it recognizes often, but was never taught.<//></div>`;
  if (message.proposals.length === 0)
    return html`<div class="panel"><${Empty} icon="proposal" title="No proposals">
      What the robot recognizes at one place on several visits appears here.<//></div>`;
  return html`
    <div class="panel">
      <${ReadOnlyNote} readOnly=${readOnly} />
      <ul class="proposals" aria-label="Proposals">
        ${message.proposals.map((one) => html`<${Proposal} key=${one.number} one=${one} disabled=${readOnly !== null} />`)}
      </ul>
    </div>`;
}

function Proposal({ one, disabled }) {
  const act = useAction();
  const [name, setName] = useState("");
  const [busy, setBusy] = useState(false);
  const picture = usePicture(one.picture);
  const send = async (verb, more, words) => {
    setBusy(true);
    const answer = await act("proposals", { verb, arguments: { number: one.number, ...more } });
    setBusy(false);
    if (answer) toast("info", words(answer));
  };
  const accept = (event) => {
    event.preventDefault();
    send("accept", name.trim() ? { name: name.trim() } : {}, (answer) => `${answer.name} is object ${answer.object_id} now.`);
  };
  return html`
    <li class="proposal">
      <img src=${picture} alt=${`Picture of ${one.name}`} />
      <form onSubmit=${accept}>
        <strong>${one.name}</strong>
        <${Facts} entries=${factsOf(one)} />
        <label class="field"><span>Name</span>
          <input class="input" value=${name} maxlength=${LONGEST_NAME} placeholder=${one.name} disabled=${disabled || busy}
            aria-label=${`Name of ${one.name}`} onInput=${(event) => setName(event.target.value)} />
        </label>
        <div class="row">
          <button class="button small primary" type="submit" disabled=${disabled || busy}>Accept</button>
          <button class="button small" type="button" disabled=${disabled || busy}
            onClick=${() => send("reject", {}, () => `${one.name} is rejected.`)}>Reject</button>
        </div>
      </form>
    </li>`;
}

/** Return the address of a JPEG image in memory. */
function usePicture(bytes) {
  const address = useMemo(() => URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" })), [bytes]);
  useEffect(() => () => URL.revokeObjectURL(address), [address]);
  return address;
}

const round = (value) => Math.round(100 * value) / 100;
