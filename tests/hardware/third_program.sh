# Runs the command that the guest was started for, and reports its exit status. Its output goes to the
# host over a virtual port.
. /mnt/exchange/environment  # REPOSITORY, COMMAND
busybox ip link set lo up
modprobe -a configfs virtio_console xhci_pci  # udev names what these find, and loads its drivers
mountpoint -q /sys/kernel/config || mount -t configfs configfs /sys/kernel/config
udevadm settle
echo "guest: the command starts after $(cut -d' ' -f1 /proc/uptime) s" >/dev/ttyS0
cd "$REPOSITORY" || exit
sh -c "$COMMAND" >/dev/virtio-ports/output 2>&1 </dev/null
echo $? >/mnt/exchange/exit_status
