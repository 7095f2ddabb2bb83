# The guest's second program, with its root in place: makes a Linux of it that runs the third one;
# with BOOTED a whole one, whose init is systemd.
. /mnt/exchange/environment  # MODULES, BOOTED
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
export PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 CAIRN_HARDWARE_GUEST=1
release=$(uname -r)
mkdir -p "/lib/modules/$release" /dev/pts /dev/shm /run
mount --bind "$MODULES" "/lib/modules/$release"  # where the kernel itself calls modprobe
mount -t tmpfs tmpfs /run
if [ -n "$BOOTED" ]; then
    mkdir -p /run/systemd/system /run/systemd/system-generators
    cp /mnt/exchange/tests.service /run/systemd/system
    for generator in /lib/systemd/system-generators/*; do
        ln -s /dev/null "/run/systemd/system-generators/${generator##*/}"  # the host's disks are none
    done
    exec /lib/systemd/systemd --unit=tests.service --log-target=journal-or-kmsg --show-status=no
fi
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
/lib/systemd/systemd-udevd --daemon
sh /mnt/exchange/third_program.sh
busybox poweroff -f
