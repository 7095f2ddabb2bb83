# The guest's second program, with its root in place: makes a Linux of it, runs the command that it
# was started for, and tells its exit status. What it prints goes to the host over a virtual port.
. /mnt/exchange/environment  # REPOSITORY, COMMAND
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
export PYTHONDONTWRITEBYTECODE=1 CAIRN_HARDWARE_GUEST=1

release=$(uname -r)
mkdir -p "/lib/modules/$release" /dev/pts /dev/shm /run
mount --bind "$MODULES" "/lib/modules/$release"  # the kernel itself calls modprobe
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t tmpfs tmpfs /run
busybox ip link set lo up
/lib/systemd/systemd-udevd --daemon
modprobe -a configfs virtio_console xhci_pci  # udev names what these find, and loads its drivers
mount -t configfs configfs /sys/kernel/config
udevadm settle

cd "$REPOSITORY" || exit
sh -c "$COMMAND" >/dev/virtio-ports/output 2>&1 </dev/null
echo $? >/mnt/exchange/exit_status
busybox poweroff -f
