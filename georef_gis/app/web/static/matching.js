// Finding a click in the other photos by its picture: what is found is proposed, and taken or not.

import { ask, latest } from "./api.js";
import { say } from "./dom.js";
import { activeVertex, draft, sent, setClicks } from "./draft.js";
import { on, tell } from "./store.js";

// photos in which one click is looked for
const MOST = 8;
const figure = latest("measure", "figure");
let looking = false;
// {vertex, own, agreed, found: [click with `taken`], refused, doubts, before, place, after, whyNot}:
// `agreed` are the own clicks as they go with those that were found
let proposal = null;

export const isLooking = () => looking;
export const getProposal = () => proposal;
export const taken = () => proposal.found.filter((click) => click.taken);

/** Look for the active vertex in the photos that show it. */
export async function find() {
  const vertex = activeVertex();
  if (!vertex || looking) return;
  const own = vertex.clicks;
  const i = draft.active;
  looking = true;
  proposal = null;
  tell("match");
  try {
    const answer = await ask("measure", "match", { clicks: sent(own), photos: null, most: MOST });
    // Who has clicked meanwhile wants something else.
    if (draft.vertices[i]?.clicks !== own) return;
    proposal = {
      vertex: i,
      own,
      agreed: answer.clicks.filter((one) => !one.matched),
      found: answer.clicks.filter((one) => one.matched).map((one) => ({ ...one, taken: true })),
      refused: answer.refused,
      doubts: answer.doubts,
      whyNot: answer.why_not,
      before: answer.before,
      place: answer.place,
      after: answer.place,
    };
    say(answer.why_not ?? `found in ${proposal.found.length} photos; look at them, then take them`);
  } catch (error) {
    say(error.message, "error");
  } finally {
    looking = false;
    tell("match");
  }
}

/** Accept or reject one of the clicks; the place that the rest gives is told at once. */
export async function toggle(click) {
  click.taken = !click.taken;
  const mine = proposal;
  const chosen = taken();
  tell("match");
  if (!chosen.length) mine.after = null;
  else if (chosen.length === mine.found.length) mine.after = mine.place;
  else {
    try {
      const clicks = sent([...mine.agreed, ...chosen]);
      const found = await figure({ shape: "point", vertices: [{ clicks }] });
      if (!found || mine !== proposal) return;
      mine.after = found.points["0"] ?? null;
    } catch (error) {
      say(error.message, "error");
    }
  }
  tell("match");
}

/** Take the accepted clicks; Step back gives them up again. */
export function take() {
  const { vertex, agreed } = proposal;
  const clicks = [...agreed, ...taken()].map(
    ({ photo, u, v, sigma_px: sigma, shared_px: shared, matched, quality }) => ({
      photo,
      u,
      v,
      sigma_px: sigma,
      shared_px: shared,
      ...(matched ? { matched, quality } : {}),
    }),
  );
  proposal = null;
  setClicks(vertex, clicks);
  tell("match");
}

export function discard() {
  proposal = null;
  tell("match");
}

on("draft", () => {
  if (!proposal || draft.vertices[proposal.vertex]?.clicks === proposal.own) return;
  proposal = null;
  tell("match");
});
