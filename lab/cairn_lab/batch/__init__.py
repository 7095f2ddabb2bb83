"""Many runs in lockstep: on processes of this computer or on a cluster, cached and checked."""
