// Commands to the robot: every one needs the lease, which is taken if it is free.

import { useCallback } from "./vendor/preact-htm.js";
import { toast, useAction } from "./hooks.js";
import { useLease } from "./lease.js";

/**
 * Return `steer(method, arguments)`: as `useAction`, after taking the lease if nobody has it.
 *
 * If another operator has it, the user is told whom to ask, and nothing is sent.
 */
export function useSteer() {
  const act = useAction();
  const lease = useLease();
  return useCallback(
    async (method, parameters = {}, options = {}) => {
      if (!lease.mine && lease.holder) {
        toast("warning", `${lease.holder} steers this robot; ask for the lease first`);
        return undefined;
      }
      if (!lease.mine && (await act("acquire_lease")) === undefined) return undefined;
      return act(method, parameters, options);
    },
    [act, lease.mine, lease.holder],
  );
}
