/* A V4L2 capture device for tests: preloaded (LD_PRELOAD), it answers open (with O_NONBLOCK), ioctl, mmap, poll and close
 * for every file below $TAGMILL_TEST_V4L2 that begins with a `struct device`, as the kernel does for a USB webcam.
 *
 * The file *is* the device: it is mapped and shared, so the test (device.py has the same structure) and all processes
 * that open it see one state; it is unplugged by `plugged = 0` or by removing the file. Pictures of MJPG modes come
 * from FILE.WIDTHxHEIGHT.mjpg ([length, bytes] again and again), those of others are grey, one step brighter each.
 *
 * As with a USB camera the picture that is on its way goes into the buffer that was queued when it began: a picture
 * that finds none queued at its beginning is lost.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define MAGIC 0x56344c32u
#define MODES 12
#define CONTROLS 12
#define BUFFERS 8
#define HANDLES 64

struct mode { uint32_t fourcc, width, height, fps[4]; };
struct control { uint32_t id, type; int32_t minimum, maximum, step, standard, value; uint32_t flags; char name[32]; };
struct device {
    uint32_t magic, plugged, stalled, frozen, cut;    /* cut: so many pictures come without their end */
    uint32_t open_errno, format_errno, start_errno;
    uint32_t streaming;                               /* pid of the process that streams, 0 = none */
    uint32_t capabilities, least_buffers;
    uint32_t mode_count, control_count;
    uint32_t fourcc, width, height, fps;              /* the present mode */
    uint32_t starts, pictures;                        /* counted: STREAMON, pictures that were delivered */
    uint32_t stamp_offset_s;                          /* a clock that is not CLOCK_MONOTONIC */
    char card[32], bus[32];
    struct mode modes[MODES];
    struct control controls[CONTROLS];
};

struct buffer { void *memory; int file; uint32_t length, used, sequence; int queued, done; struct timeval stamp; };
struct handle {
    int fd, wake;                                     /* a pipe: readable while pictures wait */
    char path[4096];
    struct device *device;
    struct buffer buffers[BUFFERS];
    uint32_t count, sequence;
    int order[BUFFERS], waiting;                      /* indices of finished buffers, oldest first */
    int active;                                       /* the buffer that is being filled, -1 = none */
    int running;
    pthread_t thread;
    pthread_mutex_t guard;
    unsigned char *pictures;
    size_t pictures_size, next_picture;
};

static struct handle *handles[HANDLES];
static pthread_mutex_t table = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name, type, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static struct handle *handle_of(int fd) {
    struct handle *found = NULL;
    pthread_mutex_lock(&table);
    for (int i = 0; i < HANDLES; i++)
        if (handles[i] && handles[i]->fd == fd) found = handles[i];
    pthread_mutex_unlock(&table);
    return found;
}

static int gone(struct handle *h) {
    struct stat about;
    return !h->device->plugged || stat(h->path, &about) != 0;
}

static int adopt(const char *path, int file) {
    const char *below = getenv("TAGMILL_TEST_V4L2");
    char full[4096];
    uint32_t magic = 0;
    if (!below || !realpath(path, full) || strncmp(full, below, strlen(below)) != 0) return file;
    if (pread(file, &magic, 4, 0) != 4 || magic != MAGIC) return file;
    close(file);
    int shared = (int)syscall(SYS_openat, AT_FDCWD, full, O_RDWR, 0);
    struct device *device = shared < 0 ? MAP_FAILED
        : mmap(NULL, sizeof *device, PROT_READ | PROT_WRITE, MAP_SHARED, shared, 0);
    if (shared >= 0) close(shared);
    if (device == MAP_FAILED) { errno = EIO; return -1; }
    int refused = device->open_errno ? (int)device->open_errno : device->plugged ? 0 : ENODEV;
    int ends[2];
    if (!refused && pipe2(ends, O_NONBLOCK | O_CLOEXEC) != 0) refused = errno;
    if (refused) { munmap(device, sizeof *device); errno = refused; return -1; }
    struct handle *h = calloc(1, sizeof *h);
    h->fd = ends[0];
    h->wake = ends[1];
    h->device = device;
    h->active = -1;
    snprintf(h->path, sizeof h->path, "%s", full);
    pthread_mutex_init(&h->guard, NULL);
    pthread_mutex_lock(&table);
    for (int i = 0; i < HANDLES; i++)
        if (!handles[i]) { handles[i] = h; break; }
    pthread_mutex_unlock(&table);
    return h->fd;
}

#define OPENER(name) \
int name(const char *path, int flags, ...) { \
    REAL(#name, int, const char *, int, ...); \
    va_list rest; va_start(rest, flags); int mode = va_arg(rest, int); va_end(rest); \
    int file = real(path, flags, mode); \
    return file < 0 || !(flags & O_NONBLOCK) ? file : adopt(path, file); \
}
OPENER(open)
OPENER(open64)

/* -- pictures -- */

static uint32_t room(struct device *d) {
    return d->fourcc == V4L2_PIX_FMT_GREY ? d->width * d->height : d->width * d->height * 2;
}

static void load_pictures(struct handle *h) {
    char path[4200];
    snprintf(path, sizeof path, "%s.%ux%u.mjpg", h->path, h->device->width, h->device->height);
    free(h->pictures);
    h->pictures = NULL;
    h->pictures_size = h->next_picture = 0;
    FILE *file = h->device->fourcc == V4L2_PIX_FMT_MJPEG ? fopen(path, "rb") : NULL;
    if (!file) return;
    fseek(file, 0, SEEK_END);
    h->pictures_size = (size_t)ftell(file);
    rewind(file);
    h->pictures = malloc(h->pictures_size);
    if (fread(h->pictures, 1, h->pictures_size, file) != h->pictures_size) h->pictures_size = 0;
    fclose(file);
}

static void fill(struct handle *h, struct buffer *b) {
    struct device *d = h->device;
    if (d->fourcc == V4L2_PIX_FMT_MJPEG) {
        if (!h->pictures_size) return;
        if (h->next_picture >= h->pictures_size) h->next_picture = 0;
        uint32_t length;
        memcpy(&length, h->pictures + h->next_picture, 4);
        b->used = length < b->length ? length : b->length;
        memcpy(b->memory, h->pictures + h->next_picture + 4, b->used);
        if (!d->frozen) h->next_picture += 4 + length;
        if (d->cut) { d->cut--; b->used /= 2; }
        return;
    }
    b->used = b->length;
    memset(b->memory, (int)(16 + h->sequence % 200), b->used);
    if (d->fourcc == V4L2_PIX_FMT_YUYV)
        for (uint32_t i = 1; i < b->used; i += 2) ((unsigned char *)b->memory)[i] = 128;
}

static void tick(struct handle *h, struct timespec now) {
    struct device *d = h->device;
    h->sequence++;
    if (h->active >= 0) {
        struct buffer *b = &h->buffers[h->active];
        fill(h, b);
        if (!d->frozen || !b->stamp.tv_sec) {
            b->stamp.tv_sec = now.tv_sec + d->stamp_offset_s;
            b->stamp.tv_usec = now.tv_nsec / 1000;
        }
        b->sequence = h->sequence;
        b->queued = 0;
        b->done = 1;
        h->order[h->waiting++] = h->active;
        h->active = -1;
        d->pictures++;
        if (write(h->wake, "p", 1) != 1) d->pictures--;
    }
    for (uint32_t i = 0; i < h->count && h->active < 0; i++) {
        uint32_t next = (h->sequence + i) % h->count;
        if (h->buffers[next].queued && !h->buffers[next].done) h->active = (int)next;
    }
}

static void *run(void *argument) {
    struct handle *h = argument;
    struct timespec due;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (;;) {
        due.tv_nsec += 1000000000L / (h->device->fps ? h->device->fps : 30);
        if (due.tv_nsec >= 1000000000L) { due.tv_nsec -= 1000000000L; due.tv_sec++; }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        pthread_mutex_lock(&h->guard);
        int running = h->running;
        if (running && gone(h)) {
            running = h->running = 0;
            close(h->wake);                           /* hang-up: whoever polls wakes */
            h->wake = -1;
            h->device->streaming = 0;
        }
        if (running && !h->device->stalled) tick(h, due);
        pthread_mutex_unlock(&h->guard);
        if (!running) return NULL;
    }
}

static void halt(struct handle *h) {
    pthread_mutex_lock(&h->guard);
    int was = h->thread != 0;
    h->running = 0;
    pthread_mutex_unlock(&h->guard);
    if (!was) return;
    pthread_join(h->thread, NULL);
    h->thread = 0;
    if (h->device->streaming == (uint32_t)getpid()) h->device->streaming = 0;
    char byte;
    while (read(h->fd, &byte, 1) == 1) continue;
    for (uint32_t i = 0; i < h->count; i++) h->buffers[i].queued = h->buffers[i].done = 0;
    h->waiting = 0;
    h->active = -1;
}

static void drop_buffers(struct handle *h) {
    for (uint32_t i = 0; i < h->count; i++) {
        munmap(h->buffers[i].memory, h->buffers[i].length);
        close(h->buffers[i].file);
    }
    memset(h->buffers, 0, sizeof h->buffers);
    h->count = 0;
}

/* -- ioctl -- */

static int fail(int error) { errno = error; return -1; }

static int used_elsewhere(struct handle *h) {
    return h->device->streaming && !h->thread;
}

static void tell_format(struct device *d, struct v4l2_pix_format *p) {
    p->pixelformat = d->fourcc;
    p->width = d->width;
    p->height = d->height;
    p->field = V4L2_FIELD_NONE;
    p->bytesperline = d->fourcc == V4L2_PIX_FMT_MJPEG ? 0 : room(d) / d->height;
    p->sizeimage = room(d);
}

/* What the camera can do that is nearest: the asked pixel format if it has that, of it the size least away. */
static int set_format(struct handle *h, struct v4l2_pix_format *p) {
    struct device *d = h->device;
    if (d->format_errno) return fail((int)d->format_errno);
    if (used_elsewhere(h) || h->count) return fail(EBUSY);
    int known = 0;
    for (uint32_t i = 0; i < d->mode_count; i++) known |= d->modes[i].fourcc == p->pixelformat;
    uint32_t fourcc = known ? p->pixelformat : d->modes[0].fourcc;
    long best = -1;
    for (uint32_t i = 0; i < d->mode_count; i++) {
        struct mode *m = &d->modes[i];
        if (m->fourcc != fourcc) continue;
        long away = labs((long)m->width - (long)p->width) + labs((long)m->height - (long)p->height);
        if (best >= 0 && away >= best) continue;
        best = away;
        d->fourcc = fourcc;
        d->width = m->width;
        d->height = m->height;
        d->fps = m->fps[0];
    }
    tell_format(d, p);
    return 0;
}

static int rate(struct handle *h, struct v4l2_captureparm *c, int set) {
    struct device *d = h->device;
    if (set && c->timeperframe.numerator) {
        double asked = (double)c->timeperframe.denominator / c->timeperframe.numerator, best = -1;
        for (uint32_t i = 0; i < d->mode_count; i++) {
            struct mode *m = &d->modes[i];
            if (m->fourcc != d->fourcc || m->width != d->width || m->height != d->height) continue;
            for (int k = 0; k < 4 && m->fps[k]; k++) {
                double away = asked > m->fps[k] ? asked - m->fps[k] : m->fps[k] - asked;
                if (best < 0 || away < best) { best = away; d->fps = m->fps[k]; }
            }
        }
    }
    c->capability = V4L2_CAP_TIMEPERFRAME;
    c->timeperframe.numerator = 1;
    c->timeperframe.denominator = d->fps;
    return 0;
}

static int request(struct handle *h, struct v4l2_requestbuffers *r) {
    if (used_elsewhere(h)) return fail(EBUSY);
    halt(h);
    drop_buffers(h);
    if (!r->count) return 0;
    if (r->count < h->device->least_buffers) r->count = h->device->least_buffers;
    if (r->count > BUFFERS) r->count = BUFFERS;
    for (uint32_t i = 0; i < r->count; i++) {
        struct buffer *b = &h->buffers[i];
        b->length = room(h->device);
        b->file = memfd_create("picture", MFD_CLOEXEC);
        if (b->file < 0 || ftruncate(b->file, b->length) != 0) return fail(ENOMEM);
        b->memory = mmap(NULL, b->length, PROT_READ | PROT_WRITE, MAP_SHARED, b->file, 0);
        h->count = i + 1;
    }
    return 0;
}

static void tell_buffer(struct handle *h, struct v4l2_buffer *v) {
    struct buffer *b = &h->buffers[v->index];
    v->length = b->length;
    v->m.offset = v->index * 4096;
    v->bytesused = b->used;
    v->sequence = b->sequence;
    v->timestamp = b->stamp;
    v->field = V4L2_FIELD_NONE;
    v->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | (b->queued ? V4L2_BUF_FLAG_QUEUED : 0) | (b->done ? V4L2_BUF_FLAG_DONE : 0);
}

static int dequeue(struct handle *h, struct v4l2_buffer *v) {
    char byte;
    if (!h->thread) return fail(EINVAL);
    if (!h->waiting) return fail(h->running ? EAGAIN : ENODEV);
    if (read(h->fd, &byte, 1) != 1) return fail(EAGAIN);
    v->index = (uint32_t)h->order[0];
    memmove(h->order, h->order + 1, sizeof h->order - sizeof *h->order);
    h->waiting--;
    h->buffers[v->index].done = 0;
    tell_buffer(h, v);
    return 0;
}

static int start(struct handle *h) {
    struct device *d = h->device;
    if (d->start_errno) return fail((int)d->start_errno);
    if (used_elsewhere(h)) return fail(EBUSY);
    if (!h->count) return fail(EINVAL);
    if (h->thread) return 0;
    load_pictures(h);
    h->running = 1;
    d->streaming = (uint32_t)getpid();
    d->starts++;
    return pthread_create(&h->thread, NULL, run, h) ? fail(EAGAIN) : 0;
}

static struct control *control_of(struct device *d, uint32_t id) {
    for (uint32_t i = 0; i < d->control_count; i++)
        if (d->controls[i].id == id) return &d->controls[i];
    return NULL;
}

/* A control that an automatism has is inactive; written to nevertheless, uvcvideo answers EACCES or EIO. */
static int inactive(struct device *d, uint32_t id) {
    struct control *exposure = control_of(d, V4L2_CID_EXPOSURE_AUTO), *focus = control_of(d, V4L2_CID_FOCUS_AUTO),
                   *balance = control_of(d, V4L2_CID_AUTO_WHITE_BALANCE);
    return (id == V4L2_CID_EXPOSURE_ABSOLUTE && exposure && exposure->value != V4L2_EXPOSURE_MANUAL) ||
           (id == V4L2_CID_FOCUS_ABSOLUTE && focus && focus->value) ||
           (id == V4L2_CID_WHITE_BALANCE_TEMPERATURE && balance && balance->value);
}

static int query_control(struct device *d, struct v4l2_queryctrl *q) {
    struct control *found = NULL;
    if (q->id & V4L2_CTRL_FLAG_NEXT_CTRL) {
        uint32_t after = q->id & ~(uint32_t)(V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND);
        for (uint32_t i = 0; i < d->control_count; i++)
            if (d->controls[i].id > after && (!found || d->controls[i].id < found->id)) found = &d->controls[i];
    } else {
        found = control_of(d, q->id);
    }
    if (!found) return fail(EINVAL);
    memset(q, 0, sizeof *q);
    q->id = found->id;
    q->type = found->type;
    memcpy(q->name, found->name, sizeof q->name);
    q->minimum = found->minimum;
    q->maximum = found->maximum;
    q->step = found->step;
    q->default_value = found->standard;
    q->flags = found->flags | (inactive(d, found->id) ? V4L2_CTRL_FLAG_INACTIVE : 0);
    return 0;
}

static int set_control(struct device *d, struct v4l2_control *c) {
    struct control *found = control_of(d, c->id);
    if (!found) return fail(EINVAL);
    if (found->flags & V4L2_CTRL_FLAG_READ_ONLY || inactive(d, c->id)) return fail(EACCES);
    if (c->value < found->minimum || c->value > found->maximum) return fail(ERANGE);
    if (found->step > 1) c->value = found->minimum + (c->value - found->minimum) / found->step * found->step;
    found->value = c->value;
    return 0;
}

static int describe_format(struct device *d, struct v4l2_fmtdesc *f) {
    uint32_t seen = 0;
    for (uint32_t i = 0; i < d->mode_count; i++) {
        int again = 0;
        for (uint32_t k = 0; k < i; k++) again |= d->modes[k].fourcc == d->modes[i].fourcc;
        if (!again && seen++ == f->index) { f->pixelformat = d->modes[i].fourcc; return 0; }
    }
    return fail(EINVAL);
}

static int describe_size(struct device *d, struct v4l2_frmsizeenum *s) {
    uint32_t seen = 0;
    for (uint32_t i = 0; i < d->mode_count; i++) {
        if (d->modes[i].fourcc != s->pixel_format || seen++ != s->index) continue;
        s->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        s->discrete.width = d->modes[i].width;
        s->discrete.height = d->modes[i].height;
        return 0;
    }
    return fail(EINVAL);
}

static int describe_rate(struct device *d, struct v4l2_frmivalenum *r) {
    for (uint32_t i = 0; i < d->mode_count; i++) {
        struct mode *m = &d->modes[i];
        if (m->fourcc != r->pixel_format || m->width != r->width || m->height != r->height) continue;
        if (r->index >= 4 || !m->fps[r->index]) return fail(EINVAL);
        r->type = V4L2_FRMIVAL_TYPE_DISCRETE;
        r->discrete.numerator = 1;
        r->discrete.denominator = m->fps[r->index];
        return 0;
    }
    return fail(EINVAL);
}

static int answer(struct handle *h, unsigned long code, void *p) {
    struct device *d = h->device;
    if (gone(h)) return fail(ENODEV);
    switch (code) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *c = p;
        memset(c, 0, sizeof *c);
        strcpy((char *)c->driver, "uvcvideo");
        memcpy(c->card, d->card, sizeof c->card);
        memcpy(c->bus_info, d->bus, sizeof c->bus_info);
        c->device_caps = d->capabilities;
        c->capabilities = d->capabilities | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_DEVICE_CAPS;
        return 0;
    }
    case VIDIOC_G_FMT: tell_format(d, &((struct v4l2_format *)p)->fmt.pix); return 0;
    case VIDIOC_S_FMT: return set_format(h, &((struct v4l2_format *)p)->fmt.pix);
    case VIDIOC_G_PARM: return rate(h, &((struct v4l2_streamparm *)p)->parm.capture, 0);
    case VIDIOC_S_PARM:
        return h->thread ? fail(EBUSY) : rate(h, &((struct v4l2_streamparm *)p)->parm.capture, 1);
    case VIDIOC_REQBUFS: return request(h, p);
    case VIDIOC_QUERYBUF:
        if (((struct v4l2_buffer *)p)->index >= h->count) return fail(EINVAL);
        tell_buffer(h, p);
        return 0;
    case VIDIOC_QBUF:
        if (((struct v4l2_buffer *)p)->index >= h->count) return fail(EINVAL);
        h->buffers[((struct v4l2_buffer *)p)->index].queued = 1;
        return 0;
    case VIDIOC_DQBUF: return dequeue(h, p);
    case VIDIOC_STREAMON: return start(h);
    case VIDIOC_QUERYCTRL: return query_control(d, p);
    case VIDIOC_G_CTRL: {
        struct control *found = control_of(d, ((struct v4l2_control *)p)->id);
        if (!found) return fail(EINVAL);
        ((struct v4l2_control *)p)->value = found->value;
        return 0;
    }
    case VIDIOC_S_CTRL: return set_control(d, p);
    case VIDIOC_ENUM_FMT: return describe_format(d, p);
    case VIDIOC_ENUM_FRAMESIZES: return describe_size(d, p);
    case VIDIOC_ENUM_FRAMEINTERVALS: return describe_rate(d, p);
    default: return fail(ENOTTY);
    }
}

int ioctl(int fd, unsigned long code, ...) {
    REAL("ioctl", int, int, unsigned long, ...);
    va_list rest;
    va_start(rest, code);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    struct handle *h = handle_of(fd);
    if (!h) return real(fd, code, argument);
    code &= 0xffffffffUL;                             /* callers that pass the code as a signed int */
    if (code == VIDIOC_STREAMOFF) { halt(h); return 0; }
    if (code == VIDIOC_REQBUFS) return answer(h, code, argument);   /* may join the thread, which takes the guard */
    pthread_mutex_lock(&h->guard);
    int result = answer(h, code, argument);
    pthread_mutex_unlock(&h->guard);
    return result;
}

#define MAPPER(name) \
void *name(void *at, size_t length, int protection, int flags, int fd, off_t offset) { \
    REAL(#name, void *, void *, size_t, int, int, int, off_t); \
    struct handle *h = fd < 0 ? NULL : handle_of(fd); \
    if (h) { \
        uint32_t index = (uint32_t)(offset / 4096); \
        if (index >= h->count) { errno = EINVAL; return MAP_FAILED; } \
        fd = h->buffers[index].file; \
        offset = 0; \
    } \
    return real(at, length, protection, flags, fd, offset); \
}
MAPPER(mmap)
MAPPER(mmap64)

/* A device that is gone, or doesn't stream, is told by POLLERR, as videobuf2 does. */
static int told(struct pollfd *list, nfds_t count, int found) {
    for (nfds_t i = 0; i < count; i++) {
        struct handle *h = handle_of(list[i].fd);
        if (!h || (h->running && !(list[i].revents & POLLHUP)) || list[i].revents & POLLIN) continue;
        if (!list[i].revents) found++;
        list[i].revents = POLLERR | POLLHUP | POLLPRI;
    }
    return found;
}

int poll(struct pollfd *list, nfds_t count, int timeout) {
    REAL("poll", int, struct pollfd *, nfds_t, int);
    return told(list, count, real(list, count, timeout));
}

int __poll_chk(struct pollfd *list, nfds_t count, int timeout, size_t size) {
    (void)size;
    return poll(list, count, timeout);
}

int close(int fd) {
    REAL("close", int, int);
    struct handle *h = fd < 0 ? NULL : handle_of(fd);
    if (h) {
        halt(h);
        drop_buffers(h);
        pthread_mutex_lock(&table);
        for (int i = 0; i < HANDLES; i++)
            if (handles[i] == h) handles[i] = NULL;
        pthread_mutex_unlock(&table);
        if (h->wake >= 0) real(h->wake);
        munmap(h->device, sizeof *h->device);
        free(h->pictures);
        free(h);
    }
    return real(fd);
}
